"""The camera of the photo that SHARP's files have, and lines on what of a file is not used."""

from pathlib import Path

import numpy as np
import pytest

from gsynopsis.formats.readers.any import read_splats
from gsynopsis.formats.readers.base import SplatFile
from tests.formats.readers.test_ply import columns_of, ply
from tests.formats.trees import tree

MATRIX = [900.0, 0, 320, 0, 800, 240, 0, 0, 1]
MOVED = [1.0, 0, 0, 0.5, 0, 1, 0, -0.25, 0, 0, 1, 2, 0, 0, 0, 1]


def read(
    folder: Path,
    intrinsic: list[float],
    size: tuple[int, ...] = (640, 480),
    extrinsic: list[float] | None = None,
) -> SplatFile:
    """A tree with the elements that SHARP writes after its splats."""
    tail = f"element intrinsic {len(intrinsic)}|property float intrinsic"
    tail += f"|element image_size {len(size)}|property uint image_size"
    data = np.array(intrinsic, "<f4").tobytes() + np.array(size, "<u4").tobytes()
    if extrinsic is not None:
        tail += f"|element extrinsic {len(extrinsic)}|property float extrinsic"
        data += np.array(extrinsic, "<f4").tobytes()
    tail += "|element color_space 1|property uchar color_space"
    (folder / "a.ply").write_bytes(ply(columns_of(tree()), {}, tail=tail) + data + b"\0")
    return read_splats(folder / "a.ply")


def test_the_photo_s_camera_is_read_and_what_is_left_is_said(tmp_path: Path) -> None:
    file = read(tmp_path, MATRIX, extrinsic=MOVED)
    assert file.photo is not None
    assert (file.photo.width, file.photo.height) == (640, 480)
    assert file.photo.matrix.ravel().tolist() == MATRIX
    assert file.photo.w2c.ravel().tolist() == MOVED
    assert file.notes == ("not used: the elements color_space",)
    assert len(file.levels[-1]) == len(tree())


def test_without_a_pose_the_camera_stands_at_the_origin(tmp_path: Path) -> None:
    photo = read(tmp_path, MATRIX).photo
    assert photo is not None
    assert np.array_equal(photo.w2c, np.eye(4))


@pytest.mark.parametrize(
    ("intrinsic", "size", "extrinsic"),
    [
        (MATRIX[:4], (640, 480), None),
        ([float("nan"), *MATRIX[1:]], (640, 480), None),
        ([-900.0, *MATRIX[1:]], (640, 480), None),
        (MATRIX, (640, 0), None),
        (MATRIX, (640,), None),
        (MATRIX, (640, 480), [2.0, *MOVED[1:]]),
        (MATRIX, (640, 480), MOVED[:12]),
    ],
)
def test_a_camera_that_is_none_is_said(
    tmp_path: Path, intrinsic: list[float], size: tuple[int, ...], extrinsic: list[float] | None
) -> None:
    file = read(tmp_path, intrinsic, size, extrinsic)
    assert file.photo is None
    assert any("not understood: the camera of a photo" in note for note in file.notes)
