"""Cameras in files are read as they were written, and what is none of these is refused."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsynopsis.cameras.given import places_beside, read_cameras
from gsynopsis.cameras.viewpoints import for_splats
from gsynopsis.errors import InputError
from gsynopsis.formats.readers.base import SplatFile
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.colmap.binary import write_binary
from gsynopsis.scene.colmap.model import Pinhole, Pose, SparseModel, quaternion_from_rotation
from tests.cameras.splat_scenes import UP, hollow_box

SCENE = hollow_box()
CAMERAS = SCENE.cameras()


def inria(cameras: list[Camera]) -> list[dict[str, Any]]:
    """Rows as 3DGS writes them."""
    return [
        {
            "id": number,
            "img_name": f"{number:04d}",
            "width": c.width,
            "height": c.height,
            "position": c.position.tolist(),
            "rotation": c.w2c[:3, :3].T.tolist(),
            "fy": c.fy,
            "fx": c.fx,
        }
        for number, c in enumerate(cameras)
    ]


def transforms(cameras: list[Camera]) -> dict[str, Any]:
    """The same as nerfstudio has it: camera to world, y up, z backward."""
    c = cameras[0]
    turn = np.diag([1.0, -1.0, -1.0, 1.0])
    frames = [
        {
            "file_path": f"images/{number}.png",
            "transform_matrix": (np.linalg.inv(c.w2c) @ turn).tolist(),
        }
        for number, c in enumerate(cameras)
    ]
    lens = {"w": c.width, "h": c.height, "fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy}
    return {**lens, "frames": frames}


def write_colmap(folder: Path, cameras: list[Camera]) -> None:
    c = cameras[0]
    poses = tuple(
        Pose(
            f"{number}.png",
            1,
            quaternion_from_rotation(camera.w2c[:3, :3]),
            tuple(camera.w2c[:3, 3].tolist()),
        )
        for number, camera in enumerate(cameras)
    )
    lens = {1: Pinhole(c.width, c.height, c.fx, c.fy, c.cx, c.cy)}
    points = np.zeros((1, 3)), np.zeros((1, 3), np.uint8)
    write_binary(folder, SparseModel(lens, poses, *points))


def same(found: list[Camera], cameras: list[Camera]) -> bool:
    lens = ("width", "height", "fx", "fy", "cx", "cy")
    assert len(found) == len(cameras)
    pairs = zip(found, cameras, strict=True)
    return all(
        np.allclose(a.w2c, b.w2c, atol=1e-9)
        and all(getattr(a, name) == pytest.approx(getattr(b, name)) for name in lens)
        for a, b in pairs
    )


@pytest.fixture
def output(tmp_path: Path) -> Path:
    """A PLY where 3DGS puts it; the file is what the tests fill in beside."""
    ply = tmp_path / "output" / "point_cloud" / "iteration_30000" / "point_cloud.ply"
    ply.parent.mkdir(parents=True)
    ply.write_bytes(b"ply\n")
    return ply


def test_cameras_of_3dgs_are_read_and_found_two_folders_above(output: Path) -> None:
    path = output.parents[2] / "cameras.json"
    assert places_beside(output) == []
    path.write_text(json.dumps(inria(CAMERAS)))
    assert places_beside(output) == [path]
    assert same(read_cameras(path), CAMERAS)
    assert same(read_cameras(path.parent), CAMERAS)


def test_cameras_of_a_colmap_model_are_read_without_photos(tmp_path: Path) -> None:
    write_colmap(tmp_path / "sparse" / "0", CAMERAS)
    for path in (tmp_path, tmp_path / "sparse" / "0", tmp_path / "sparse" / "0" / "images.bin"):
        assert same(read_cameras(path), CAMERAS)
    assert places_beside(tmp_path / "a.ply") == [tmp_path]


def test_cameras_of_a_transforms_json_are_read_without_photos(tmp_path: Path) -> None:
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps(transforms(CAMERAS)))
    assert same(read_cameras(path), CAMERAS)
    assert places_beside(tmp_path / "a.ply") == [path]


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("width", 0, r"`int` >= 1 - at `\$\[1\]\.width`"),
        ("fx", -1.0, r"\$\[1\]\.fx"),
        ("position", [0, 1], r"\$\[1\]\.position"),
        ("position", [0, 1, 1e300], r"\$\[1\]\.position"),
        ("rotation", [[1, 0, 0], [0, 2, 0], [0, 0, 1]], "camera 1: rotation"),
        ("rotation", [[1, 0, 0], [0, 1, 0], [0, 0, -1]], "camera 1: rotation"),
    ],
)
def test_damaged_cameras_are_refused_by_name(
    tmp_path: Path, key: str, value: object, words: str
) -> None:
    rows = inria(CAMERAS)
    rows[1][key] = value
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps(rows))
    with pytest.raises(InputError, match=words):
        read_cameras(path)


NO_CAMERAS = ("", "[", "[]", "{}", "[1]", "ply", "[" * 5000, '{"frames": []}', '[{"\udcff": 1}]')


@pytest.mark.parametrize("text", NO_CAMERAS)
def test_what_are_no_cameras_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "cameras.json"
    path.write_text(text, "utf-8", "surrogateescape")
    with pytest.raises(InputError):
        read_cameras(path)


def test_a_folder_without_cameras_and_a_path_of_nothing_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected a cameras\.json"):
        read_cameras(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        read_cameras(tmp_path / "nothing.json")


def test_cameras_that_see_nothing_of_the_scene_are_refused() -> None:
    away = [
        Camera(c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.w2c @ shifted(500.0)) for c in CAMERAS
    ]
    file = SplatFile((SCENE.gaussians,), up=UP)
    with pytest.raises(InputError, match=f"nothing in view of {len(away)} cameras"):
        for_splats(file, given=away)
    found = for_splats(file, given=CAMERAS)
    assert found.given
    assert same(list(found.cameras), CAMERAS)
    assert np.allclose(found.up, UP, atol=1e-6)


def shifted(by: float) -> np.ndarray:
    """A world whose origin is so far away."""
    matrix = np.eye(4)
    matrix[0, 3] = by
    return matrix
