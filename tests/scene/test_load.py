"""Reading a folder: splits, and what is refused, left out or made up for."""

import shlex
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsynopsis.errors import SceneError
from gsynopsis.scene.colmap.binary import write_binary
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.splits import split_names, split_views
from tests.scene.tiny_models import tiny_model


def test_bungee_holds_out_the_first_31_views(tmp_path):
    train, test, notes = split_views(tmp_path, 40, "bungee")
    assert test == tuple(range(31)) and train == tuple(range(31, 40)) and notes == ()
    with pytest.raises(SceneError, match="images: found 31, expected more than 31 images for"):
        split_views(tmp_path, 31, "bungee")


def test_no_split_trains_on_all_and_says_so(tiny):
    scene = load_scene(tiny(), "none")
    assert scene.train == scene.test == (0, 1, 2)
    assert "test views were trained on" in scene.notes[0]


@pytest.mark.parametrize(("count", "held"), [(2, 1), (8, 1), (9, 2), (194, 25), (292, 37)])
def test_every_eighth_is_as_many_as_the_literature_says(tmp_path, count, held):
    assert len(split_views(tmp_path, count, "every8")[1]) == held


def test_views_of_one_panorama_are_held_out_together(tmp_path: Path) -> None:
    names = sorted(f"view{number}/{place:02}.jpg" for number in range(8) for place in range(10))
    train, test, notes = split_names(tmp_path, names, "every8")
    held = [f"view{number}/{place}.jpg" for number in range(8) for place in ("00", "08")]
    assert [names[i] for i in test] == held and len(train) == 64
    assert notes == ("views of one panorama are held out together: 2 of 10",)
    mixed = [*names, "z.jpg"]
    assert len(split_names(tmp_path, mixed, "validation")[1]) == 8
    # Of a single panorama all else would be nothing, and other photos have no such names.
    for alone in (names[::10], ["view/a.jpg", "viewx1/a.jpg", "b.jpg"]):
        assert split_names(tmp_path, alone, "every8") == split_views(tmp_path, len(alone), "every8")


def test_a_folder_that_is_missing_or_empty_is_refused(tmp_path):
    with pytest.raises(SceneError, match="found no such folder, expected the folder of a scene"):
        load_scene(tmp_path / "nowhere")
    with pytest.raises(SceneError, match=r"found neither a model in sparse/0 nor a transforms"):
        load_scene(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(SceneError, match="found a file, expected the folder of a scene"):
        load_scene(tmp_path / "file")


def test_missing_photos_are_left_out_and_named_all_at_once(tiny):
    root = tiny([f"{i}.png" for i in range(6)])
    for name in ("2.png", "4.png"):
        (root / "images" / name).unlink()
    scene = load_scene(root)
    assert [view.name for view in scene.views] == ["0.png", "1.png", "3.png", "5.png"]
    assert scene.account.left_out == {"not on disk": ("2.png", "4.png")}
    assert scene.account.text().startswith("4 of 6 photos used, poses of sparse/0; 2 not on disk")
    for name in ("1.png", "3.png", "5.png"):
        (root / "images" / name).unlink()
    words = r"images: found 1 of use, 5 not on disk \(.* and 2 more\), expected at least 2"
    with pytest.raises(SceneError, match=words) as caught:
        load_scene(root)
    assert "\n" not in str(caught.value)


def test_a_photo_of_another_size_is_refused_at_load(tiny):
    root = tiny()
    Image.new("RGB", (10, 12)).save(root / "images" / "b.png")
    with pytest.raises(SceneError, match=r"b\.png: image size: found 10x12, expected 12x10"):
        load_scene(root)


def test_a_damaged_photo_is_refused_at_first_use(tiny):
    root = tiny()
    path = root / "images" / "b.png"
    path.write_bytes(path.read_bytes()[:-60])
    scene = load_scene(root)
    assert scene.image(0, 1).shape == (10, 12, 3)
    with pytest.raises(SceneError, match=r"b\.png: pixels: found .*, expected a whole image; copy"):
        scene.image(1, 1)


@pytest.mark.parametrize("names", [["../a.png", "b.png"], ["/a.png", "b.png"]])
def test_a_model_that_names_files_outside_its_images_is_refused(tmp_path, names):
    write_binary(tmp_path / "sparse" / "0", tiny_model(names))
    (tmp_path / "images").mkdir()
    with pytest.raises(SceneError, match=r"image name: found .*, expected a name inside"):
        load_scene(tmp_path)


def test_one_image_is_refused(tiny):
    with pytest.raises(SceneError, match="images: found 1, expected at least 2"):
        load_scene(tiny(["a.png"]))


@pytest.mark.parametrize("points", ["none", "no file", "ply"])
def test_known_poses_without_points_get_some_that_stand_in(tiny, points):
    root = tiny(points=0)
    sparse = root / "sparse" / "0"
    if points != "none":
        (sparse / "points3D.bin").unlink()
    if points == "ply":
        fields = "".join(f"property float {axis}\n" for axis in "xyz")
        fields += "".join(f"property double {name}\n" for name in ("red", "green", "blue"))
        header = f"ply\nformat ascii 1.0\nelement vertex 2\n{fields}end_header\n"
        (sparse / "points3D.ply").write_text(f"{header}1 2 3 1 0.5 0\n4 5 6 0 0 1\n")
    scene = load_scene(root)
    if points == "ply":
        assert scene.points.tolist() == [[1, 2, 3], [4, 5, 6]] and scene.notes == ()
        assert scene.colors.tolist() == [[255, 128, 0], [0, 0, 255]]
    else:
        places = np.stack([view.camera.position for view in scene.views])
        assert scene.points.shape == (10_000, 3)
        away = np.linalg.norm(scene.points - places.mean(axis=0), axis=1).max()
        radius = np.linalg.norm(places - places.mean(axis=0), axis=1).max()
        assert 0.99 * radius < away <= radius * (1 + 1e-12)
        assert scene.notes[0].startswith("sparse/0 has no points: 10000 random ones")


def test_a_name_too_long_for_the_file_system_is_refused(tmp_path):
    write_binary(tmp_path / "sparse" / "0", tiny_model(["a.png", "ä" * 200]))
    (tmp_path / "images").mkdir()
    Image.new("RGB", (12, 10)).save(tmp_path / "images" / "a.png")
    with pytest.raises(SceneError, match="found File name too long, expected a readable scene"):
        load_scene(tmp_path)


@pytest.mark.parametrize("images", ["images", "."])
def test_photos_without_poses_are_told_what_makes_a_scene_of_them(tmp_path, images):
    root = tmp_path / "my photos"
    (root / images).mkdir(parents=True)
    for name in ("a.jpg", "b.JPG", "c.png", "notes.txt"):
        (root / images / name).write_bytes(b"")
    with pytest.raises(SceneError) as caught:
        load_scene(root)
    message = str(caught.value)
    assert "found 3 photos without camera poses, expected photos with poses" in message
    words = shlex.split(message.split("first: ")[1].split(", then train")[0])
    assert words == ["gsynopsis", "scene", str(root), f"{root}_scene"]
    assert f"train '{root}_scene'" in message and "\n" not in message
