"""A COLMAP sparse model on disk → cameras by image name, and points.

Rigs and frames (rigs.bin, frames.bin, COLMAP 3.12 and later) repeat what images.bin says and are
not read. Observations and tracks are checked for length and passed over.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import SceneError
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.colmap_binary import read_binary
from gsynopsis.scene.colmap_layout import (
    Pose,
    SparseModel,
    rotation_from_quaternion,
)
from gsynopsis.scene.colmap_text import read_text

FILES = ("cameras", "images", "points3D")


def find_sparse(root: Path) -> Path | None:
    """The folder of the sparse model: `root/sparse/0`, or `root/sparse` if that holds it."""
    for folder in (root / "sparse" / "0", root / "sparse"):
        if any((folder / f"cameras.{kind}").is_file() for kind in ("bin", "txt")):
            return folder
    for folder in (root / "sparse" / "0", root / "sparse"):
        if folder.is_dir():
            return folder
    return None


def read_sparse(folder: Path) -> SparseModel:
    """The sparse model in `folder`, binary if it holds any binary file, else text.

    Raises:
        SceneError: A file is missing, unreadable, truncated or holds what cannot be.
    """
    binary = any((folder / f"{name}.bin").is_file() for name in FILES)
    kind = "bin" if binary else "txt"
    for name in FILES:
        path = folder / f"{name}.{kind}"
        if not path.is_file():
            advice = "a sparse model is cameras, images and points3D, all .bin or all .txt"
            raise SceneError(path, found="no such file", expected="COLMAP's file", advice=advice)
    model = read_binary(folder) if binary else read_text(folder)
    _check_points(folder / f"points3D.{kind}", model.points)
    for image in model.images:
        if image.camera not in model.cameras:
            wanted = f"one of {sorted(model.cameras)[:5]}"
            path = folder / f"images.{kind}"
            field = f"image {image.name} camera"
            raise SceneError(path, field, found=image.camera, expected=wanted)
    return model


def _check_points(path: Path, points: NDArray[np.float64]) -> None:
    if not len(points):
        advice = "the reconstruction is empty: run COLMAP's mapper again"
        raise SceneError(path, "points", found=0, expected="at least 1", advice=advice)
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad):
        found = points[bad[0]].tolist()
        raise SceneError(path, f"point {bad[0]} xyz", found=found, expected="finite numbers")


def cameras_by_name(model: SparseModel) -> list[tuple[str, Camera]]:
    """The camera of each registered image, in the model's order."""
    return [(image.name, _camera(model, image)) for image in model.images]


def _camera(model: SparseModel, image: Pose) -> Camera:
    w2c = np.eye(4)
    w2c[:3, :3] = rotation_from_quaternion(image.quaternion)
    w2c[:3, 3] = image.translation
    c = model.cameras[image.camera]
    return Camera(c.width, c.height, c.fx, c.fy, c.cx, c.cy, w2c)
