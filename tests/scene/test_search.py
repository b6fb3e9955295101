"""Models, photos and poses of other programs, wherever people have them."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsynopsis.errors import SceneError
from gsynopsis.scene.account import estimated_account
from gsynopsis.scene.colmap.binary import write_binary
from gsynopsis.scene.colmap.read import find_sparse
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.other_poses import other_poses
from gsynopsis.scene.scene import SceneOptions
from gsynopsis.scene.search import find_models
from tests.scene.tiny_models import tiny_model

NAMES = tuple(f"{n}.png" for n in range(9))
Make = Callable[..., Path]


@pytest.mark.parametrize(
    "place",
    [
        "sparse/0",
        "sparse",
        "sparse/12",
        ".",
        "colmap/sparse/0",
        "colmap/sparse",
        "dense/0/sparse",
        "dense/sparse",
        "distorted/sparse/0",
        "colmap_text",
        "0",
        "colmap/dense/0/sparse",
    ],
)
def test_a_model_is_found_where_programs_leave_it(tiny: Make, place: str) -> None:
    root = tiny(NAMES)
    (root / "sparse" / "0").rename(root / "model_files")
    shutil.rmtree(root / "sparse")
    shutil.copytree(root / "model_files", root / place, dirs_exist_ok=True)
    shutil.rmtree(root / "model_files")
    scene = load_scene(root)
    assert len(scene.views) == 9 and len(scene.points) == 7
    own = "the model in the folder itself" if place == "." else place
    assert scene.account.source == own and scene.account.beside == ()


@pytest.mark.parametrize("folder", ["dense/0/images", "dense/images", "input", "sparse/0/images"])
def test_photos_are_found_beside_a_model_and_above(tiny: Make, folder: str) -> None:
    root = tiny(NAMES)
    (root / "model").mkdir()
    model = {"input": "sparse/0", "sparse/0/images": "sparse/0"}.get(folder, "dense/0/sparse")
    if model != "sparse/0":
        (root / model).parent.mkdir(parents=True)
        (root / "sparse" / "0").rename(root / model)
    (root / folder).parent.mkdir(parents=True, exist_ok=True)
    (root / "images").rename(root / folder)
    scene = load_scene(root)
    assert {view.path.parent for view in scene.views} == {root / folder}


@pytest.mark.parametrize(("small", "large"), [("0", "1"), ("1", "0"), ("2", "10")])
def test_of_several_models_that_with_most_photos_is_read_and_the_others_are_named(
    tiny: Make, small: str, large: str
) -> None:
    root = tiny(NAMES)
    (root / "sparse" / "0").rename(root / "sparse" / "large")
    (root / "sparse" / "large").rename(root / "sparse" / large)
    write_binary(root / "sparse" / small, tiny_model(NAMES[:3]))
    write_binary(root / "colmap" / "sparse" / "0", tiny_model(NAMES[:4]))
    scene = load_scene(root)
    assert len(scene.views) == 9 and scene.account.source == f"sparse/{large}"
    assert scene.account.beside == (
        "2 other models are not read (colmap/sparse/0 with 4 photos, "
        f"sparse/{small} with 3 photos): "
        "to use one, take the others away",
    )


def test_a_model_whose_photos_are_gone_or_that_is_damaged_is_not_the_best(tiny: Make) -> None:
    root = tiny(NAMES[:4])
    write_binary(root / "sparse" / "1", tiny_model([f"gone{n}.png" for n in range(20)]))
    write_binary(root / "sparse" / "2", tiny_model(NAMES))
    (root / "sparse" / "2" / "images.bin").write_bytes(b"broken")
    scene = load_scene(root)
    assert scene.account.source == "sparse/0" and len(scene.views) == 4
    assert "(sparse/1 with 0 photos, sparse/2, damaged)" in scene.account.text()
    shutil.rmtree(root / "sparse" / "0")
    shutil.rmtree(root / "sparse" / "1")
    with pytest.raises(SceneError, match=r"sparse/2/images\.bin: .* found 6 bytes"):
        load_scene(root)


def test_photos_under_near_names_count_for_the_choice_of_a_model(tiny: Make) -> None:
    root = tiny(NAMES)
    write_binary(root / "sparse" / "0", tiny_model(NAMES[:3]))
    write_binary(root / "sparse" / "1", tiny_model([name.upper() for name in NAMES]))
    assert load_scene(root).account.source == "sparse/1"


def test_folders_of_other_scenes_and_of_our_own_work_are_not_looked_into(tiny: Make) -> None:
    root = tiny(NAMES)
    above = root.parent
    assert find_models(above) == [] and find_sparse(above) is None
    for name in ("sfm", "sparse_city", "models_of_cars/sparse", "7/sparse/0"):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copytree(root / "sparse" / "0", root / name)
    assert find_models(root) == [root / "sparse" / "0"]
    (root / "sparse" / "1").symlink_to(root / "sparse")
    assert find_models(root) == [root / "sparse" / "0"]


def test_copies_of_the_photos_are_taken_where_they_are_asked_for(tiny: Make) -> None:
    root = tiny(NAMES)
    shutil.copytree(root / "images", root / "images_2")
    scene = load_scene(root, reading=SceneOptions(images="images_2"))
    assert scene.views[0].path == root / "images_2" / "0.png"


def test_photos_without_a_pose_and_files_of_other_endings_are_in_the_account(tiny: Make) -> None:
    root = tiny(NAMES[:5])
    write_binary(root / "sparse" / "0", tiny_model(NAMES[:3]))
    for name in ("images/a.HEIC", "images/b.heic", "images/cam/c.dng", "way.mp4", "notes.txt"):
        (root / name).parent.mkdir(exist_ok=True)
        (root / name).write_bytes(b"")
    for name in ("images/masks/0.png", "images/.hidden.png", "images/Thumbs.db"):
        (root / name).parent.mkdir(exist_ok=True)
        (root / name).write_bytes(b"")
    (root / "images" / "cam" / "d.Jpg").write_bytes(b"")
    account = load_scene(root).account
    assert account.left_out == {"without a pose": ("3.png", "4.png", "cam/d.Jpg")}
    assert account.unread == {".heic": 2, ".dng": 1, ".mp4": 1}
    assert account.text() == (
        "3 of 6 photos used, poses of sparse/0; 3 without a pose (3.png, 4.png, cam/d.Jpg); "
        "not looked at: 1 .dng, 2 .heic, 1 .mp4 (convert photos to JPEG or PNG, HEIC by "
        "heif-convert or on the phone itself, give a video itself in place of the folder); held "
        "out by rule every8; masks: none"
    )


@pytest.mark.parametrize(
    ("listed", "stored"),
    [
        ("a.JPG", "a.jpg"),
        ("Zu\u0308rich.png", "Z\u00fcrich.png"),
        ("images/a.png", "a.png"),
        ("left\\a.png", "left/a.png"),
        ("ÉTÉ.PNG", "E\u0301te\u0301.png"),
    ],
)
def test_photos_whose_names_a_copy_changed_are_found(tiny: Make, listed: str, stored: str) -> None:
    root = tiny(("0.png", "1.png", stored))
    write_binary(root / "sparse" / "0", tiny_model(("0.png", "1.png", listed)))
    scene = load_scene(root)
    assert root / "images" / stored in {view.path for view in scene.views}
    assert len(scene.views) == 3 and scene.account.left_out == {}
    assert ("1 photos have names that differ" in " ".join(scene.notes)) == ("\\" not in listed)


POSES = {
    "Metashape": ("my project.xml", b'<?xml version="1.0"?>\n<document v="2">\n <chunk label="x">'),
    "Meshroom": ("cameras.sfm", b'{"version": ["1"], "views": [{"viewId": "1", "poseId": "1"}]}'),
    "OpenSfM": ("reconstruction.json", b'[{"cameras": {}, "shots": {}}]'),
    "LLFF": ("poses_bounds.npy", b"\x93NUMPY"),
    "RealityCapture": ("registration.csv", b"#name,x,y,alt,heading,pitch,roll,f,px,py,k1\n"),
    "RealityCapture without a header": ("my.csv", b"IMG 1.jpg,-1.5,2,3,0.1,0.2,0.3\n"),
    "VisualSFM": ("scene.nvm", b"NVM_V3 \n"),
}


@pytest.mark.parametrize("program", POSES)
def test_poses_of_other_programs_are_named_with_what_helps(tmp_path: Path, program: str) -> None:
    name, content = POSES[program]
    (tmp_path / name).write_bytes(content)
    (tmp_path / "other.csv").write_text("date,steps\n")
    (tmp_path / "other.xml").write_text("<rss/>")
    (tmp_path / "other.json").write_text("{}")
    phrases = other_poses(tmp_path, tmp_path)
    assert len(phrases) == 1
    program = program.removesuffix(" without a header")
    assert phrases[0].startswith(f"poses of {program} are not read ({name}): ")
    for number in range(3):
        Image.fromarray(np.full((8, 8, 3), number, np.uint8)).save(tmp_path / f"{number}.png")
    with pytest.raises(SceneError, match="found 3 photos without camera poses") as caught:
        load_scene(tmp_path)
    said = phrases[0].partition(": ")[0]
    assert said in str(caught.value) and "\n" not in str(caught.value)
    assert (": to use them" in phrases[0]) == (
        program in ("Metashape", "OpenSfM", "RealityCapture")
    )


def test_poses_of_other_programs_beside_a_model_are_in_the_account(tiny: Make) -> None:
    root = tiny(NAMES)
    (root / "poses_bounds.npy").write_bytes(b"")
    assert "poses of LLFF are not read (poses_bounds.npy)" in load_scene(root).account.text()


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"account": 3}', '{"account": {"photos": "x"}}'])
def test_a_broken_account_of_an_estimation_changes_nothing(tmp_path: Path, text: str) -> None:
    (tmp_path / "scene.json").write_text(text)
    assert estimated_account(tmp_path).left_out == {}
    assert estimated_account(tmp_path / "nowhere").photos == 0


def test_folders_of_pictures_that_nothing_reads_are_in_the_account(tiny: Make) -> None:
    root = tiny(NAMES)
    assert load_scene(root).account.beside == ()
    for name in ("images_2", "depth", ".hidden", "few/deep"):
        shutil.copytree(root / "images", root / name)
    (phrase,) = load_scene(root).account.beside
    assert phrase == "folders of pictures that are not read: depth (9), images_2 (9)"
    shutil.copytree(root / "images", root / "images_mask")
    (phrase,) = load_scene(root).account.beside
    assert phrase.endswith(": masks are read from masks/, of their photos' names and sizes")


def test_the_folder_of_a_project_says_in_which_of_its_folders_scenes_lie(
    tiny: Make, tmp_path: Path
) -> None:
    root, project = tiny(NAMES), tmp_path / "project"
    shutil.copytree(root, project / "data" / "posed")
    shutil.copytree(root / "images", project / "photos" / "images")
    (project / "docs").mkdir()
    with pytest.raises(SceneError, match=r"one of the folders in it: data/posed, photos$"):
        load_scene(project)
    assert len(load_scene(project / "data" / "posed").views) == 9
    with pytest.raises(SceneError, match="found 9 photos without camera poses"):
        load_scene(project / "photos")


def test_where_most_photos_have_no_pose_the_account_says_how_to_estimate_them(tiny: Make) -> None:
    root = tiny(NAMES)

    def beside(names: list[str]) -> str:
        for name in names:
            shutil.copy(root / "images" / "0.png", root / "images" / name)
        return " ".join(load_scene(root).account.beside)

    assert beside([f"more{n}.png" for n in range(9)]) == ""
    assert beside([f"{n}_depth_0001.png" for n in range(9)]) == ""
    originals = root / "input"
    originals.mkdir()
    for n in range(19):
        shutil.copy(root / "images" / "0.png", originals / f"{n}.png")
    assert f"gsynopsis scene {originals} NEW" in beside([])
    shutil.rmtree(originals)
    said = beside(["last.png"])
    assert said == f"most photos have no pose: gsynopsis scene {root} NEW estimates those of all"
