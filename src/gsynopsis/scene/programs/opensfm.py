"""OpenSfM's reconstruction.json, which OpenDroneMap leaves in opensfm/ → `Poses`.

After OpenSfM's documentation (*Dataset structure*, *Geometric models*): lengths are shares of an
image's longer side and are taken from its centre; a shot's rotation is an angle times its axis,
world to camera, x right, y down, z forward.
"""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import SceneError
from gsynopsis.files import read_regular
from gsynopsis.scene.colmap.distortion import STRAIGHT, Lens
from gsynopsis.scene.colmap.model import LARGEST, LARGEST_SIDE, NO_POINTS, Pinhole
from gsynopsis.scene.programs.posed_photos import MOST_BYTES, PosedPhoto, Poses

PERSPECTIVE = ("perspective", "brown", "radial", "simple_radial")
FISHEYE = ("fisheye", "fisheye_opencv")


class _Camera(msgspec.Struct):
    projection_type: str = "perspective"
    width: int = 0
    height: int = 0
    focal: float | None = None
    focal_x: float | None = None
    focal_y: float | None = None
    aspect_ratio: float = 1.0
    c_x: float = 0.0
    c_y: float = 0.0
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    p1: float = 0.0
    p2: float = 0.0


class _Shot(msgspec.Struct):
    camera: str
    rotation: tuple[float, float, float]
    translation: tuple[float, float, float]


class _Point(msgspec.Struct):
    coordinates: tuple[float, float, float]
    color: tuple[float, float, float] = (128.0, 128.0, 128.0)


class _Reconstruction(msgspec.Struct):
    cameras: dict[str, _Camera] = {}
    shots: dict[str, _Shot] = {}
    points: dict[str, _Point] = {}


def read_opensfm(path: Path) -> Poses:
    """The reconstruction with most shots.

    Raises:
        SceneError: the file is not such JSON, or a number in it cannot be.
    """
    data = read_regular(path, MOST_BYTES, SceneError)
    try:
        every = msgspec.json.decode(data, type=list[_Reconstruction])
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        wanted = "OpenSfM's reconstructions"
        raise SceneError(path, found=str(error)[:100], expected=wanted) from error
    best = max(every, key=lambda one: len(one.shots), default=None)
    if best is None or not best.shots:
        raise SceneError(path, found="no shot", expected="a reconstruction")
    others = [one for one in every if one is not best]
    beside = [f"a reconstruction of {len(one.shots)} shots is not read" for one in others]
    cameras = {key: _pinhole(path, key, one) for key, one in best.cameras.items()}
    photos, unknown = list[PosedPhoto](), list[tuple[str, str]]()
    for name, shot in best.shots.items():
        if shot.camera not in best.cameras:
            raise SceneError(path, f"shot {name[:100]}: camera", found=shot.camera[:100])
        camera = cameras[shot.camera]
        if camera is None:
            unknown.append((name, best.cameras[shot.camera].projection_type[:40]))
            continue
        w2c = np.eye(4)
        w2c[:3, :3] = rotation_of(np.array(shot.rotation))
        w2c[:3, 3] = shot.translation
        photos.append(PosedPhoto(name, camera, w2c, f"camera {shot.camera[:100]}"))
    return Poses(path, tuple(photos), _points(best), beside=tuple(beside), unknown=tuple(unknown))


def rotation_of(turn: NDArray[np.float64]) -> NDArray[np.float64]:
    """The rotation [3, 3] about an axis by its length [3], radians (Rodrigues)."""
    angle = float(np.linalg.norm(turn))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = turn / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def _pinhole(path: Path, key: str, camera: _Camera) -> Pinhole | None:
    """The camera in pixels; None of a model that is not read (spherical, dual)."""
    if camera.projection_type not in {*PERSPECTIVE, *FISHEYE}:
        return None
    field, sides = f"camera {key[:100]}", (camera.width, camera.height)
    if not all(1 <= side <= LARGEST_SIDE for side in sides):
        raise SceneError(path, f"{field}: size", found=sides, expected="whole pixels")
    longer = max(sides)
    fx = camera.focal_x if camera.focal is None else camera.focal
    fy = camera.focal_y
    if fy is None and fx is not None:
        fy = fx * camera.aspect_ratio
    numbers: list[Any] = [fx, fy, camera.c_x, camera.c_y]
    if fx is None or fy is None or not all(abs(v) < LARGEST for v in numbers) or min(fx, fy) <= 0:
        raise SceneError(path, f"{field}: focal", found=fx, expected="a positive number")
    radial = (camera.k1, camera.k2, camera.k3, camera.k4)
    fisheye = camera.projection_type in FISHEYE
    lens = Lens(fisheye, radial, tangential=(camera.p1, camera.p2))
    return Pinhole(
        *sides,
        fx * longer,
        fy * longer,
        camera.width / 2 + camera.c_x * longer,
        camera.height / 2 + camera.c_y * longer,
        STRAIGHT if lens.straight else lens,
    )


def _points(one: _Reconstruction) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    if not one.points:
        return NO_POINTS
    places = np.array([point.coordinates for point in one.points.values()], np.float64)
    colors = np.array([point.color for point in one.points.values()], np.float64)
    return places, colors.clip(0, 255).round().astype(np.uint8)
