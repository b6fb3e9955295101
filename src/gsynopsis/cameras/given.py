"""Cameras that stand in files: 3DGS's cameras.json, a COLMAP model, a transforms.json.

A cameras.json is the list that 3DGS writes beside what it trained, one object for each photo with
`width`, `height`, `fx`, `fy` in pixels, `position` in the world [3], and `rotation`, rows of the
matrix from the camera's axes (x right, y down, z forward) to the world's [3, 3]. Photos are not
needed, and distortion of lenses is passed over: what was trained has none.
"""

from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from gsynopsis.errors import InputError, SceneError
from gsynopsis.files import read_regular
from gsynopsis.scene.camera import Camera, nearest_rotation, world_to_camera
from gsynopsis.scene.colmap.model import LARGEST, LARGEST_SIDE, rotation_from_quaternion
from gsynopsis.scene.colmap.read import read_sparse
from gsynopsis.scene.search import find_models
from gsynopsis.scene.transforms import find_transforms, read_poses

NAME = "cameras.json"
EXPECTED = "a cameras.json of 3DGS, a COLMAP model, or a transforms.json"
MOST_BYTES = 1 << 26
"""Most bytes of a cameras.json: 100,000 cameras have half of that."""
RIGID_TOLERANCE = 1e-2
"""Largest difference of RᵀR from the identity in any element; it is then brought to a rotation."""
_Focal = Annotated[float, msgspec.Meta(gt=0, lt=LARGEST)]
_Number = Annotated[float, msgspec.Meta(gt=-LARGEST, lt=LARGEST)]
_Vector = tuple[_Number, _Number, _Number]


def read_cameras(path: Path) -> list[Camera]:
    """The cameras of a file or folder, in its order; those without a finite pose are left out.

    Args:
        path: A cameras.json or transforms.json, or a folder with one of these or with a COLMAP
            model, in itself or as a scene has it.

    Raises:
        InputError: It is none of these, or damaged, or has no cameras.
    """
    try:
        cameras = _folder(path) if path.is_dir() else _file(path)
    except OSError as error:
        raise InputError(path, found=error.strerror or error, expected=EXPECTED) from error
    if not cameras:
        raise InputError(path, "cameras", found="none with a finite pose", expected="at least one")
    return cameras


def places_beside(source: Path) -> list[Path]:
    """Usual places of a splat file's cameras that exist, likely ones first.

    3DGS writes cameras.json two folders above point_cloud/iteration_N/point_cloud.ply.
    """
    folder = source.parent
    folders = [folder]
    if folder.name.startswith("iteration_") and folder.parent.name == "point_cloud":
        folders.append(folder.parent.parent)
    found: list[Path] = []
    for place in folders:
        found += [place / NAME] if (place / NAME).is_file() else []
        found += [place] if (place / "sparse").is_dir() and find_models(place) else []
        found += find_transforms(place)[:1]
    return found


def _folder(path: Path) -> list[Camera]:
    if (path / NAME).is_file():
        return _inria(path / NAME)
    models, transforms = find_models(path), find_transforms(path)
    if models:
        return _colmap(models[0])
    if transforms:
        return [camera for file in transforms for camera in read_poses(file)]
    raise InputError(path, found="a folder with none of these", expected=EXPECTED)


def _file(path: Path) -> list[Camera]:
    if not path.exists():
        raise InputError(path, found="no such file", expected=EXPECTED)
    if path.suffix in (".bin", ".txt") and path.stem in ("cameras", "images", "points3D"):
        return _colmap(path.parent)
    data = read_regular(path, MOST_BYTES, InputError)
    start = data[:64].lstrip(b"\xef\xbb\xbf \t\r\n")
    if start.startswith(b"{"):
        return read_poses(path)
    if start.startswith(b"["):
        return _inria(path)
    raise InputError(path, found=f"a file that begins with {start[:8]!r}", expected=EXPECTED)


def _colmap(folder: Path) -> list[Camera]:
    model = read_sparse(folder)
    out: list[Camera] = []
    for image in model.images:
        if image.camera not in model.cameras:
            raise SceneError(
                folder, f"image {image.name} camera", found=image.camera, expected="a known camera"
            )
        own, w2c = model.cameras[image.camera], np.eye(4)
        w2c[:3, :3] = rotation_from_quaternion(image.quaternion)
        w2c[:3, 3] = image.translation
        out.append(Camera(own.width, own.height, own.fx, own.fy, own.cx, own.cy, w2c))
    return out


class _Row(msgspec.Struct):
    """A camera of a cameras.json."""

    width: Annotated[int, msgspec.Meta(ge=1, le=LARGEST_SIDE)]
    height: Annotated[int, msgspec.Meta(ge=1, le=LARGEST_SIDE)]
    fx: _Focal
    fy: _Focal
    position: tuple[_Number, _Number, _Number]
    rotation: tuple[_Vector, _Vector, _Vector]


def _inria(path: Path) -> list[Camera]:
    try:
        rows = msgspec.json.decode(read_regular(path, MOST_BYTES, InputError), type=list[_Row])
    except (msgspec.DecodeError, RecursionError) as error:
        raise InputError(path, found=error, expected=f"3DGS's {NAME}") from error
    return [_posed(path, number, row) for number, row in enumerate(rows)]


def _posed(path: Path, number: int, row: _Row) -> Camera:
    rotation, position = np.array(row.rotation), np.array(row.position)
    nearest, off = nearest_rotation(rotation, RIGID_TOLERANCE)
    if nearest is None:
        field = f"camera {number}: rotation"
        raise InputError(path, field, found=f"RᵀR off by {off:.3g}", expected="a rotation")
    w2c = world_to_camera(nearest, position)
    middle = (row.width / 2, row.height / 2)
    return Camera(row.width, row.height, row.fx, row.fy, *middle, w2c)
