"""A COLMAP sparse model on disk → a `Listing`.

Rigs and frames (rigs.bin, frames.bin, COLMAP 3.12 and later) repeat what images.bin says and are
not read. Observations and tracks are checked for length and passed over.
"""

from pathlib import Path

import numpy as np

from gsynopsis.errors import SceneError
from gsynopsis.scene.colmap_binary import read_binary, read_binary_tracks
from gsynopsis.scene.colmap_layout import (
    Pose,
    SparseModel,
    Tracks,
    rotation_from_quaternion,
)
from gsynopsis.scene.colmap_text import read_text, read_text_tracks
from gsynopsis.scene.views import Listing, View, place_of, view_of

FILES = ("cameras", "images", "points3D")


def find_sparse(root: Path) -> Path | None:
    """The folder of the sparse model: `root/sparse/0`, or `root/sparse` if that holds it.

    A folder counts if any file of a model is in it; None if there is no such folder.
    """
    for folder in (root / "sparse" / "0", root / "sparse"):
        if any((folder / f"{name}.{kind}").is_file() for name in FILES for kind in ("bin", "txt")):
            return folder
    return None


def read_sparse(folder: Path) -> SparseModel:
    """The sparse model in `folder`, binary if it holds any binary file, else text.

    Raises:
        SceneError: A file is missing, unreadable, truncated or holds what cannot be.
    """
    kind = _kind(folder)
    for name in FILES:
        path = folder / f"{name}.{kind}"
        if not path.is_file():
            advice = "a sparse model is cameras, images and points3D, all .bin or all .txt"
            raise SceneError(path, found="no such file", expected="COLMAP's file", advice=advice)
    return read_binary(folder) if kind == "bin" else read_text(folder)


def read_tracks(folder: Path) -> tuple[Tracks, dict[int, str]]:
    """Which images of the sparse model in `folder` show each point, and their names by number.

    Raises:
        SceneError: As `read_sparse`.
    """
    binary = _kind(folder) == "bin"
    tracks = read_binary_tracks(folder) if binary else read_text_tracks(folder)
    return tracks, {image.number: image.name for image in read_sparse(folder).images}


def _kind(folder: Path) -> str:
    return "bin" if any((folder / f"{name}.bin").is_file() for name in FILES) else "txt"


def read_colmap(root: Path, sparse: Path, images: Path | None = None) -> Listing:
    """The scene of a sparse model whose photos lie in `images`, `root/images` if None.

    Raises:
        SceneError: As `read_sparse`; there is no folder of images; or an image names no camera
            or leads out of its folder.
    """
    model = read_sparse(sparse)
    folder = root / "images" if images is None else images
    if not folder.is_dir():
        raise SceneError(folder, found="no such folder", expected="the scene's photos")
    path = sparse / f"images.{_kind(sparse)}"
    views = tuple(_view(path, model, image, folder) for image in model.images)
    return Listing(path, views, model.points, model.colors)


def _view(path: Path, model: SparseModel, image: Pose, folder: Path) -> View:
    place = place_of(path, folder, image.name)
    if image.camera not in model.cameras:
        wanted = f"a camera of {path.with_stem('cameras').name}"
        raise SceneError(path, f"image {image.name} camera", found=image.camera, expected=wanted)
    w2c = np.eye(4)
    w2c[:3, :3] = rotation_from_quaternion(image.quaternion)
    w2c[:3, 3] = image.translation
    field, cameras = f"camera {image.camera}", path.with_stem("cameras")
    return view_of(cameras, field, (image.name, place), model.cameras[image.camera], w2c)
