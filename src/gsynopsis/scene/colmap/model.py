"""Records of a COLMAP sparse model, and the checks that both its readers share."""

import math
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import SceneError
from gsynopsis.scene.colmap.distortion import PARAMS, STRAIGHT, Lens, lens_of

MODEL_NAMES = (
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "OPENCV_FISHEYE",
    "FULL_OPENCV",
    "FOV",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "THIN_PRISM_FISHEYE",
    "RAD_TAN_THIN_PRISM_FISHEYE",
    "SIMPLE_DIVISION",
    "DIVISION",
    "SIMPLE_FISHEYE",
    "FISHEYE",
    "EUCM",
    "EQUIRECTANGULAR",
)
"""COLMAP's camera models; the index is the number that cameras.bin holds."""
SPHERE = "EQUIRECTANGULAR"
KNOWN = {**PARAMS, SPHERE: 2}
"""Models that are read, and the number of their parameters."""
LARGEST_SIDE = 1 << 16
"""Pixels; a wider or taller camera is a damaged file."""
LARGEST = 1e12
"""Above any coordinate or length that is meant; a larger one is a damaged file."""
DEEPEST = 4
"""Folders of a scene at most, from its own to a model's."""
QUATERNION_TOLERANCE = 0.02
"""Largest distance from 1 of a quaternion's norm; some text files are rounded to two digits."""


@dataclass(frozen=True)
class Pinhole:
    """Intrinsics of one COLMAP camera, all in pixels, and its lens, straight in a pinhole camera.

    COLMAP, like `Camera`, puts (0, 0) at the corner of the first pixel, so numbers carry over.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    lens: Lens = STRAIGHT
    sphere: bool = False
    """A panorama, see `spheres`; focal lengths mean nothing."""

    def resized(self, width: int, height: int) -> "Pinhole":
        """The same camera for a photo resized to width × height pixels."""
        sx, sy = width / self.width, height / self.height
        fx, fy, cx, cy = self.fx * sx, self.fy * sy, self.cx * sx, self.cy * sy
        return Pinhole(width, height, fx, fy, cx, cy, self.lens, self.sphere)


def panorama(width: int, height: int) -> Pinhole:
    """The camera of a panorama of the whole sphere."""
    return Pinhole(width, height, 1.0, 1.0, width / 2, height / 2, sphere=True)


@dataclass(frozen=True)
class Pose:
    """One registered image: world to camera as a unit quaternion (w, x, y, z) and a translation."""

    name: str
    camera: int
    quaternion: tuple[float, float, float, float]
    translation: tuple[float, float, float]
    number: int = field(default=0, compare=False)
    """By which the tracks of its file name it."""


@dataclass(frozen=True)
class Tracks:
    """Images that show each point, one row per observation.

    Attributes:
        images: Number of the image, int64 [O].
        points: Row of the point, int64 [O].
    """

    images: NDArray[np.int64]
    points: NDArray[np.int64]


NO_TRACKS = Tracks(np.zeros(0, np.int64), np.zeros(0, np.int64))


Points = tuple[NDArray[np.float64], NDArray[np.uint8], Tracks]
"""Places [P, 3] in world units, colours [P, 3] in sRGB, and the images that show them."""
NO_POINTS = np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
"""Points and colours of a model that has none."""


@dataclass(frozen=True)
class SparseModel:
    """A sparse model without its observations in pixels, which nothing here needs.

    Attributes:
        cameras: By id.
        images: Those with a pose.
        points: Empty without points, or if they were not requested.
        colors: Colours of the points.
        lost: Names of images whose pose is not finite.
        notes: Corrections made while reading, a sentence each.
        tracks: Images that show the points; empty where the files have none.
    """

    cameras: dict[int, Pinhole]
    images: tuple[Pose, ...]
    points: NDArray[np.float64]  # [P, 3] world units
    colors: NDArray[np.uint8]  # [P, 3] sRGB
    lost: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    tracks: Tracks = NO_TRACKS


def undistort_advice(root: Path | str, images: str = "images", sparse: str = "sparse/0") -> str:
    """The command that turns a scene with lens distortion into one without.

    If there is no such model yet, the command that makes one comes first.
    """
    begin = "undistort first: "
    if not (Path(root) / sparse).is_dir():
        begin += f"{_reconstruct(root, images)}, then "
    return begin + _undistort(root, images, sparse)


def poses_advice(root: Path) -> str:
    """The command that makes a scene of photos alone."""
    scene = quoted(f"{root}_scene")
    return f"estimate them first: gsynopsis scene {quoted(root)} {scene}, then train {scene}"


def _reconstruct(root: Path | str, images: str) -> str:
    return (
        f"colmap automatic_reconstructor --image_path {quoted(Path(root) / images)} "
        f"--workspace_path {quoted(root)} --single_camera 1 --dense 0"
    )


def _undistort(root: Path | str, images: str, sparse: str) -> str:
    return (
        f"colmap image_undistorter --image_path {quoted(Path(root) / images)} "
        f"--input_path {quoted(Path(root) / sparse)} "
        f"--output_path {quoted(f'{root}_undistorted')} --output_type COLMAP"
    )


def quoted(path: Path | str) -> str:
    """A path as one word of a shell."""
    return shlex.quote(str(path))


def refuse_model(path: Path, camera: int, model: str) -> SceneError:
    """The error for a camera model that cannot be read, with the command that helps."""
    folder = path.parent
    usual = folder.parent if folder.name == "sparse" else folder.parent.parent
    above = [folder, *folder.parents][:DEEPEST]
    root = next((place for place in above if (place / "images").is_dir()), usual)
    return SceneError(
        path,
        f"camera {camera} model",
        found=model,
        expected=f"one of {', '.join(KNOWN)}",
        advice=undistort_advice(root, sparse=str(folder.relative_to(root))),
    )


def pinhole(
    path: Path, camera: int, model: str, size: tuple[int, int], params: Sequence[float]
) -> Pinhole:
    """Checked intrinsics and lens of a camera whose model is one of `KNOWN`.

    Args:
        path: The file they come from, for messages.
        camera: The camera's id, for messages.
        model: Its model's name.
        size: Width and height, pixels.
        params: Focal lengths and principal point, pixels, then the lens's.

    Raises:
        SceneError: A size, focal length or principal point that cannot be.
    """
    field = f"camera {camera}"
    if not all(1 <= side <= LARGEST_SIDE for side in size):
        limit = f"1 to {LARGEST_SIDE} pixels a side"
        raise SceneError(path, f"{field} size", found=f"{size[0]}x{size[1]}", expected=limit)
    if model == SPHERE:
        return panorama(*size)
    (fx, fy, cx, cy), lens = lens_of(model, params)
    if not all(abs(x) < LARGEST for x in params) or min(fx, fy) <= 0:
        wanted = "finite numbers and a positive focal length"
        raise SceneError(path, f"{field} parameters", found=list(params), expected=wanted)
    return Pinhole(*size, fx, fy, cx, cy, lens)


def pose(path: Path, name: str, camera: int, numbers: Sequence[float]) -> Pose | None:
    """A checked pose, the quaternion brought to unit length; None if a number is not finite.

    Args:
        path: The file it comes from, for messages.
        name: The image's name.
        camera: The id of its camera.
        numbers: Quaternion (w, x, y, z) and translation (3), world to camera.

    Raises:
        SceneError: A number is too large or the quaternion is not a rotation.
    """
    if not all(map(math.isfinite, numbers)):
        return None
    if not all(abs(x) < LARGEST for x in numbers):
        found, wanted = [float(x) for x in numbers], f"finite numbers below {LARGEST:g}"
        raise SceneError(path, f"image {name} pose", found=found, expected=wanted)
    w, x, y, z, *shift = (float(v) for v in numbers)
    norm = math.hypot(w, x, y, z)
    if abs(norm - 1) > QUATERNION_TOLERANCE:
        found = f"a quaternion of length {norm:.6g}"
        raise SceneError(path, f"image {name} pose", found=found, expected="length 1 (a rotation)")
    quaternion = (w / norm, x / norm, y / norm, z / norm)
    return Pose(name, camera, quaternion, (shift[0], shift[1], shift[2]))


def rotation_from_quaternion(q: Sequence[float]) -> NDArray[np.float64]:
    """Rotation matrix, float64 [3, 3], of a unit quaternion (w, x, y, z)."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(rotation: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Unit quaternion (w, x, y, z), w ≥ 0, of a rotation matrix [3, 3].

    The quaternion is the eigenvector of the largest eigenvalue of Bar-Itzhack's symmetric
    matrix, which has no branch and no weak spot at half turns.
    """
    r = rotation
    symmetric = np.array(
        [
            [r[0, 0] + r[1, 1] + r[2, 2], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [0, r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]],
            [0, 0, r[1, 1] - r[0, 0] - r[2, 2], r[1, 2] + r[2, 1]],
            [0, 0, 0, r[2, 2] - r[0, 0] - r[1, 1]],
        ]
    )
    w, x, y, z = np.linalg.eigh(symmetric, UPLO="U")[1][:, -1]
    sign = -1.0 if w < 0 else 1.0
    return float(sign * w), float(sign * x), float(sign * y), float(sign * z)
