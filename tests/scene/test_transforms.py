"""transforms.json in both forms, against geometry worked out by hand and against COLMAP."""

import json
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gsynopsis.errors import SceneError
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.transforms import find_transforms, read_transforms

Frame = dict[str, Any]


def pose(x: float = 0.0) -> list[list[float]]:
    """Camera to world, OpenGL axes, at (x, 0, 4), looking down the world's z axis."""
    return [[1, 0, 0, x], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Writes photos 16 × 12 and a transforms file; further values go to its top."""

    def make(file: str = "transforms.json", names: tuple[str, ...] = ("a.png", "b.png"), **top):
        frames = [
            {"file_path": f"images/{name}", "transform_matrix": pose(i)}
            for i, name in enumerate(names)
        ]
        for name in names:
            path = tmp_path / "images" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.new("RGB", (16, 12), (9, 8, 7)).save(path)
        values = {"fl_x": 20.0, "fl_y": 21.0, "cx": 7.5, "cy": 6.5, "w": 16, "h": 12}
        (tmp_path / file).write_text(json.dumps(values | {"frames": frames} | top))
        return tmp_path

    return make


def test_opengl_axes_become_opencv_axes(write):
    camera = load_scene(write()).views[1].camera
    np.testing.assert_allclose(camera.position, [1, 0, 4], atol=1e-15)
    np.testing.assert_allclose(camera.forward, [0, 0, -1], atol=1e-15)
    # A world point up and to the right of the camera's axis lies up (small y) and right.
    x, y, z = (camera.w2c @ [1.5, 0.25, 0, 1])[:3]
    np.testing.assert_allclose([x, y, z], [0.5, -0.25, 4], atol=1e-15)


def test_up_of_a_finished_splat_is_read(write):
    assert load_scene(write()).up is None
    assert load_scene(write(gsynopsis_up=[0, 1, 2])).up == (0.0, 1.0, 2.0)


@pytest.mark.parametrize("up", [[0, 0, 0], [0, 1], "z", [1e400, 0, 0], [True, 0, 0], {}])
def test_an_up_that_is_none_is_one_line(write, up):
    with pytest.raises(SceneError, match=r"gsynopsis_up.*expected three numbers"):
        load_scene(write(gsynopsis_up=up))


def test_nerfstudio_intrinsics_are_global_or_of_a_frame(write):
    root = write()
    values = json.loads((root / "transforms.json").read_text())
    values["frames"][1] |= {"fl_x": 30.0, "cx": 9.0}
    (root / "transforms.json").write_text(json.dumps(values))
    first, second = (view.camera for view in load_scene(root).views)
    assert (first.fx, first.fy, first.cx, first.cy) == (20, 21, 7.5, 6.5)
    assert (second.fx, second.fy, second.cx, second.cy) == (30, 21, 9, 6.5)
    assert (first.width, first.height) == (16, 12)


def test_blender_files_give_angle_names_without_extension_and_the_split(tmp_path):
    for part, count in (("train", 3), ("test", 2)):
        (tmp_path / part).mkdir()
        frames: list[Frame] = []
        for i in range(count):
            Image.new("RGBA", (20, 10), (200, 100, 50, 0)).save(tmp_path / part / f"r_{i}.5.png")
            frames.append({"file_path": f"./{part}/r_{i}.5", "transform_matrix": pose(i + 0.1)})
        text = json.dumps({"camera_angle_x": 2 * np.arctan(0.5), "frames": frames})
        (tmp_path / f"transforms_{part}.json").write_text(text)
    scene = load_scene(tmp_path)
    names = ["test/r_0.5.png", "test/r_1.5.png"] + [f"train/r_{i}.5.png" for i in range(3)]
    assert [view.name for view in scene.views] == names
    assert scene.test == (0, 1) and scene.train == (2, 3, 4)
    camera = scene.views[0].camera
    # Half the width over tan(half the angle) = 10 / 0.5.
    assert [camera.fx, camera.fy, camera.cx, camera.cy] == pytest.approx([20, 20, 10, 5])
    assert (scene.image(0, 1) == 0).all()
    assert "split by transforms_train.json and its test file" in scene.notes
    assert "json have no points: 10000 random ones" in " ".join(scene.notes)


def test_a_train_file_alone_is_split_like_any_scene(write):
    scene = load_scene(write("transforms_train.json", names=tuple(f"{i}.png" for i in range(9))))
    assert scene.test == (0, 8)


def test_without_points_a_seeded_cloud_stands_in_and_is_noted(write):
    root = write()
    scene, again = load_scene(root), load_scene(root)
    np.testing.assert_array_equal(scene.points, again.points)
    assert len(scene.points) == len(scene.colors) == 10_000
    distance = np.linalg.norm(scene.points - [0.5, 0, 4], axis=1)
    assert 0.49 < distance.max() <= 0.5
    assert "10000 random ones inside the cameras' bounding sphere" in scene.notes[0]


def test_points_come_from_the_ply_file_that_is_named(write):
    root = write(ply_file_path="points.ply")
    fields = "property float x\nproperty float y\nproperty float z\n"
    text = f"ply\nformat ascii 1.0\nelement vertex 2\n{fields}end_header\n1 2 3\n4 5 6\n"
    (root / "points.ply").write_text(text)
    scene = load_scene(root)
    assert scene.points.tolist() == [[1, 2, 3], [4, 5, 6]] and scene.notes == ()


def test_a_colmap_scene_told_as_transforms_is_the_same_scene(tiny):
    root = tiny()
    colmap = load_scene(root)
    frames: list[Frame] = []
    for view in colmap.views:
        c2w = np.linalg.inv(view.camera.w2c) * [1, -1, -1, 1]
        frames.append({"file_path": f"images/{view.name}", "transform_matrix": c2w.tolist()})
    c = colmap.views[0].camera
    values = {"fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy, "k1": 0, "camera_model": "OPENCV"}
    (root / "transforms.json").write_text(json.dumps(values | {"frames": frames}))
    (root / "sparse").rename(root / "elsewhere")
    for one, two in zip(load_scene(root).views, colmap.views, strict=True):
        assert one.path == two.path
        np.testing.assert_allclose(one.camera.w2c, two.camera.w2c, atol=1e-14)
        assert one.camera.cx == two.camera.cx and one.camera.fy == two.camera.fy


@pytest.mark.parametrize(
    ("top", "words"),
    [
        ({"k5": 0.03}, "k5: found 0.03, expected 0, or camera_model FULL_OPENCV; undistort first"),
        ({"s1": -1e-3}, "s1: found -0.001, expected 0.*colmap image_undistorter --image_path"),
        (
            {"camera_model": "EQUIRECTANGULAR"},
            "panorama: found 16x12, expected the whole sphere",
        ),
        ({"k1": -9.0}, "frame 0: camera distortion: found a lens that folds over within the photo"),
        ({"fl_x": None}, "frame 0: fl_x: found None, expected fl_x or camera_angle_x"),
        ({"fl_x": -2}, "fl_x: found -2.0, expected a positive number"),
        ({"fl_x": "20"}, "fl_x: found '20', expected a finite number"),
        ({"fl_x": True}, "fl_x: found True, expected a finite number"),
        ({"fl_x": 10**400}, "fl_x: found 10+, expected a finite number"),
        ({"fl_x": None, "camera_angle_x": 4}, "camera_angle_x: found 4.0, expected an angle"),
        ({"cx": float("nan")}, "cx: found nan, expected a finite number"),
        ({"w": 16.5}, "w: found 16.5, expected whole pixels"),
        ({"w": 17}, r"a\.png: image size: found 16x12, expected 17x12 as its camera says"),
        ({"frames": {}}, r"transforms\.json: frames: found {}, expected a list"),
        ({"frames": [7]}, "frame 0: found 7, expected a JSON object"),
        ({"frames": []}, "images: found 0, expected at least 2"),
        ({"ply_file_path": "../x.ply"}, "image name: found '../x.ply', expected a name inside"),
    ],
)
def test_what_cannot_be_is_refused(write, top, words):
    with pytest.raises(SceneError, match=words) as caught:
        load_scene(write(**top))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        ({"file_path": "../../x.png"}, "image name: found '../../x.png', expected a name inside"),
        ({"file_path": 5}, "frame 1: file_path: found 5, expected a text"),
        ({"file_path": "images/gone"}, r"images: found 1 of use, 1 not on disk \(images/gone\)"),
        ({"s2": 0.5}, "frame 1: s2: found 0.5, expected 0"),
        ({"transform_matrix": None}, "frame 1: transform_matrix: found "),
        ({"transform_matrix": [[1, 2], [3]]}, "transform_matrix: found .*expected 4 x 4 numbers"),
        ({"transform_matrix": [[1, 2], [3, 4]]}, r"found \[2, 2\], expected 4 x 4 numbers"),
        (
            {"transform_matrix": np.full((4, 4), np.nan).tolist()},
            r"1 of use, 1 with a pose that is not finite \(images/b\.png\), expected at least 2",
        ),
        ({"transform_matrix": np.full((4, 4), 1e13).tolist()}, "is too large.*expected finite"),
        ({"transform_matrix": np.diag([2, 1, 1, 1]).tolist()}, "off by 1.5.*expected a rigid pose"),
        ({"transform_matrix": np.diag([1, 1, -1, 1]).tolist()}, "expected a rigid pose"),
        ({"transform_matrix": [[10**400] * 4] * 4}, "expected 4 x 4 numbers"),
    ],
)
def test_a_frame_that_cannot_be_is_named(write, frame, words):
    root = write()
    values = json.loads((root / "transforms.json").read_text())
    values["frames"][1] |= frame
    (root / "transforms.json").write_text(json.dumps(values))
    with pytest.raises(SceneError, match=words) as caught:
        load_scene(root)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("lost", [float("nan"), float("-inf"), None])
def test_lost_and_missing_frames_are_left_out_and_named(write, lost):
    root = write(names=tuple(f"{i}.png" for i in range(6)))
    values = json.loads((root / "transforms.json").read_text())
    values["frames"][2]["transform_matrix"][1][3] = lost
    (root / "images" / "4.png").unlink()
    Image.new("RGB", (16, 12)).save(root / "images" / "more.png")
    (root / "transforms.json").write_text(json.dumps(values))
    scene = load_scene(root)
    assert [view.name for view in scene.views] == [f"images/{i}.png" for i in (0, 1, 3, 5)]
    assert scene.account.left_out == {
        "with a pose that is not finite": ("images/2.png",),
        "not on disk": ("images/4.png",),
        "without a pose": ("images/more.png",),
    }


def test_names_with_backslashes_or_of_another_case_are_found(write):
    root = write()
    values = json.loads((root / "transforms.json").read_text())
    values["frames"][0]["file_path"] = ".\\images\\a.png"
    values["frames"][1]["file_path"] = "images/B.PNG"
    (root / "transforms.json").write_text(json.dumps(values))
    scene = load_scene(root)
    assert [view.name for view in scene.views] == ["images/a.png", "images/b.png"]
    assert "1 photos have names that differ" in scene.notes[0]


def test_every_truncation_of_the_file_is_refused(write):
    path = write() / "transforms.json"
    whole = path.read_bytes()
    for size in range(len(whole)):
        path.write_bytes(whole[:size])
        with pytest.raises(SceneError, match=r"transforms\.json: found .*, expected JSON"):
            load_scene(path.parent)


@pytest.mark.parametrize("text", ["[]", "3", "null", "[" * 100_000])
def test_json_of_another_kind_is_refused(tmp_path, text):
    (tmp_path / "transforms.json").write_text(text)
    with pytest.raises(SceneError, match=r"transforms\.json: found .*, expected (a )?JSON"):
        load_scene(tmp_path)


@pytest.mark.parametrize("sparse", ["", "colmap/sparse/0", "sparse/0"])
def test_advice_on_distortion_names_only_what_is_there_or_comes_to_be(tmp_path, sparse):
    root = tmp_path / "scene"
    (root / "photos").mkdir(parents=True)
    if sparse:
        (root / sparse).mkdir(parents=True)
    frame = {"file_path": "photos/a.png", "transform_matrix": np.eye(4).tolist()}
    content = {"fl_x": 20, "w": 16, "h": 12, "k5": 0.1, "frames": [frame]}
    (root / "transforms.json").write_text(json.dumps(content))
    with pytest.raises(SceneError) as caught:
        read_transforms(root, find_transforms(root))
    advice = str(caught.value).split("undistort first: ")[1]
    words = shlex.split(advice.replace(",", " "))
    paths = {words[k - 1]: Path(words[k]) for k in range(1, len(words)) if words[k - 1][:2] == "--"}
    assert paths["--image_path"] == root / "photos"
    assert paths["--input_path"] == root / (sparse or "sparse/0")
    assert ("automatic_reconstructor" in advice) == (not sparse)
    if not sparse:
        assert paths["--workspace_path"] == root


@pytest.mark.parametrize("scale", [0.5, 30.0])
def test_a_scale_of_poses_is_taken_out_and_said(write, scale: float) -> None:
    plain = load_scene(write())
    path = plain.root / "transforms.json"
    values = json.loads(path.read_text())
    for frame in values["frames"]:
        pose = np.array(frame["transform_matrix"], float)
        pose[:3, :3] *= scale
        frame["transform_matrix"] = pose.tolist()
    path.write_text(json.dumps(values))
    scene = load_scene(plain.root)
    assert any(f"poses have a scale, the first {scale:g}" in note for note in scene.notes)
    for one, two in zip(scene.views, plain.views, strict=True):
        np.testing.assert_allclose(one.camera.w2c, two.camera.w2c, atol=1e-12)


def test_k4_of_metashape_is_the_factor_of_the_eighth_power(write) -> None:
    root = write(k1=-0.1, k2=0.05, k3=-0.02, k4=0.01)
    warp = load_scene(root).views[0].form.warp
    assert warp is not None
    x = 0.4
    bent = warp.lens.distorted(np.array([[x, 0.0]]))[0, 0]
    assert bent == pytest.approx(x * (1 - 0.1 * x**2 + 0.05 * x**4 - 0.02 * x**6 + 0.01 * x**8))


@pytest.mark.parametrize(("times", "told"), [((0.0, 0.5), True), ((0.5, 0.5), False)])
def test_photos_of_several_moments_are_told(write, times, told) -> None:
    root = write()
    values = json.loads((root / "transforms.json").read_text())
    for frame, moment in zip(values["frames"], times, strict=True):
        frame["time"] = moment
    (root / "transforms.json").write_text(json.dumps(values))
    assert any("2 moments" in note for note in load_scene(root).notes) == told


@pytest.mark.parametrize("there", ["images", "."])
@pytest.mark.parametrize("said", ["../photos/{}", "/home/me/{}", "C:\\shots\\{}", "frames/{}"])
def test_photos_that_were_moved_are_found_by_their_names_and_it_is_said(write, said, there):
    root = write(names=("a.png", "b.png", "c.png"))
    values = json.loads((root / "transforms.json").read_text())
    for frame, name in zip(values["frames"], ("a.png", "b.png", "c.png"), strict=True):
        frame["file_path"] = said.format(name)
        (root / "images" / name).rename(root / there / name)
    (root / there / "c.png").unlink()
    (root / "transforms.json").write_text(json.dumps(values))
    scene = load_scene(root)
    assert len(scene.views) == 2
    told = "2 photos are not where the file says and were found by their names, as "
    assert any(note.startswith(told) for note in scene.notes)
    assert "1 not on disk" in scene.account.text()


def test_a_name_of_two_frames_is_not_looked_for_elsewhere(write):
    root = write()
    values = json.loads((root / "transforms.json").read_text())
    for number, frame in enumerate(values["frames"]):
        frame["file_path"] = f"left{number}/a.png"
    (root / "transforms.json").write_text(json.dumps(values))
    with pytest.raises(SceneError, match=r"images: found 0 of use, 2 not on disk"):
        load_scene(root)


def test_a_missing_file_of_points_is_said_and_others_stand_in(write):
    scene = load_scene(write(ply_file_path="x.ply"))
    assert scene.random_points
    assert scene.notes[0] == "transforms.json: ply_file_path x.ply is not on disk"
