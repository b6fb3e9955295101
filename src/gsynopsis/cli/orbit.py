"""Cameras that fly around a scene, and the pictures' size."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gsynopsis.records import Frame, LevelSet
from gsynopsis.scene.camera import Camera

Vector = NDArray[np.float64]
META = "orbit"
"""Under this name a file's meta data holds the circle of its training cameras."""
DIGITS = 7
"""Significant digits of the numbers in that text."""
DEFAULT_SIZE = (960, 540)
"""Width and height of pictures without a scene, pixels."""
DEFAULT_FOV = 60.0
"""Horizontal field of view without a scene, degrees."""
CAMERA_MARGIN = 1.1
"""The frame's extent is this times the largest distance of a camera from their mean."""
NEAR_SHARE = 0.1
"""A target nearer than this share of the cameras' spread is not what they look at."""
TILT = 20.0
"""Elevation of an orbit without a scene, degrees."""


@dataclass(frozen=True)
class Circle:
    """A round flight: where it looks, which way is up, how far and how high it flies.

    Attributes:
        target: What is looked at, world units [3].
        up: Away from the ground, unit length [3].
        ahead: Direction from the axis to the first camera, unit length, at right angles to `up`.
        radius: Distance of the cameras from the axis, world units.
        height: Height of the cameras over the target along `up`, world units.
    """

    target: Vector
    up: Vector
    ahead: Vector
    radius: float
    height: float


def circle_of_levels(levels: LevelSet) -> Circle:
    """The circle that a file carries in its meta data, else one from its frame."""
    text = levels.meta.get(META)
    circle = None if text is None else parse_circle(text)
    return circle or circle_of_frame(levels.frame)


def circle_text(circle: Circle) -> str:
    """A circle as the text that a file carries."""
    values = {name: _short(np.atleast_1d(value)) for name, value in asdict(circle).items()}
    return json.dumps(values, separators=(",", ":"))


def parse_circle(text: str) -> Circle | None:
    """The circle in a text of `circle_text`; None if it is not one that can be flown."""
    try:
        values = json.loads(text)
        target, up, ahead = (
            np.array(values[name], np.float64).reshape(3) for name in ("target", "up", "ahead")
        )
        radius, height = (float(values[name][0]) for name in ("radius", "height"))
    except (ValueError, LookupError, TypeError, OverflowError, RecursionError):
        return None
    numbers = [*target, *up, *ahead, radius, height]
    if not np.isfinite(numbers).all() or radius < 0 or not up.any():
        return None
    up = _unit(up)
    return Circle(target, up, _across(ahead, up), radius, height)


def circle_of_frame(frame: Frame) -> Circle:
    """A circle when a file carries none: around its centre, at the training cameras' distance.

    Up is -y, as in most COLMAP models.
    """
    distance = frame.extent / CAMERA_MARGIN
    tilt = np.radians(TILT)
    return Circle(
        target=frame.center.astype(np.float64),
        up=np.array([0.0, -1.0, 0.0]),
        ahead=np.array([0.0, 0.0, -1.0]),
        radius=float(distance * np.cos(tilt)),
        height=float(distance * np.sin(tilt)),
    )


def circle_of_cameras(cameras: Sequence[Camera]) -> Circle:
    """A circle near real cameras: around the point they look at, at their mean distance.

    Up is the mean of the cameras' own. The target is the point nearest to all viewing axes; where
    that is not in front of the cameras (parallel axes, or cameras that look outwards), it is a
    point ahead of their middle.
    """
    positions = np.stack([camera.position for camera in cameras])
    forwards = np.stack([camera.forward for camera in cameras])
    up = _unit(-np.stack([camera.w2c[1, :3] for camera in cameras]).mean(axis=0))
    middle = positions.mean(axis=0)
    spread = float(np.linalg.norm(positions - middle, axis=1).max())
    target = nearest_to_axes(positions, forwards)
    depth = float(((target - positions) * forwards).sum(axis=1).mean())
    if depth < NEAR_SHARE * spread:
        target = middle + 2 * spread * _unit(forwards.mean(axis=0))
    away = positions - target
    flat = away - (away @ up)[:, None] * up
    return Circle(
        target=target,
        up=up,
        ahead=_across(flat[0], up),
        radius=float(np.linalg.norm(flat, axis=1).mean()),
        height=float((away @ up).mean()),
    )


def nearest_to_axes(positions: Vector, forwards: Vector) -> Vector:
    """The point with the least squared distance to all viewing axes, [3].

    Parallel axes leave it undetermined along them; a weak pull to the cameras' mean decides.

    Args:
        positions: Camera centres [C, 3].
        forwards: Viewing directions, unit length [C, 3].
    """
    across = np.eye(3) - forwards[:, :, None] * forwards[:, None, :]  # [C, 3, 3]
    pull = 1e-3 * np.eye(3)
    total = across.mean(axis=0) + pull
    moment = (across @ positions[:, :, None])[:, :, 0].mean(axis=0)
    return np.asarray(np.linalg.solve(total, moment + pull @ positions.mean(axis=0)), np.float64)


def orbit(circle: Circle, lens: Camera, count: int) -> list[Camera]:
    """`count` cameras evenly around the circle, with the size and lens of `lens`."""
    sideways = np.cross(circle.up, circle.ahead)
    cameras: list[Camera] = []
    for angle in np.arange(count) * (2 * np.pi / count):
        direction = np.cos(angle) * circle.ahead + np.sin(angle) * sideways
        eye = circle.target + circle.radius * direction + circle.height * circle.up
        cameras.append(replace(lens, w2c=look_at(eye, circle.target, circle.up)))
    return cameras


def look_at(eye: Vector, target: Vector, up: Vector) -> Vector:
    """World to camera, float64 [4, 4]: at `eye`, looking at `target`, `up` upwards in the image."""
    forward = _unit(target - eye)
    right = _across(np.cross(forward, up), forward)
    w2c = np.eye(4)
    w2c[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    w2c[:3, 3] = -w2c[:3, :3] @ eye
    return w2c


def default_lens() -> Camera:
    """The lens of pictures without a scene."""
    width, height = DEFAULT_SIZE
    focal = width / 2 / float(np.tan(np.radians(DEFAULT_FOV / 2)))
    return Camera(width, height, focal, focal, width / 2, height / 2, np.eye(4))


def sized(camera: Camera, width: int | None, height: int | None) -> Camera:
    """The camera for another picture size; one number keeps the shape."""
    if width is None and height is None:
        return camera
    if width is None:
        width = max(1, round(camera.width * (height or 1) / camera.height))
    if height is None:
        height = max(1, round(camera.height * width / camera.width))
    # The focal length follows the height, so another shape shows more or less at the sides.
    zoom = height / camera.height
    return replace(
        camera,
        width=width,
        height=height,
        fx=camera.fx * zoom,
        fy=camera.fy * zoom,
        cx=width / 2 + (camera.cx - camera.width / 2) * zoom,
        cy=camera.cy * zoom,
    )


def _short(values: Vector) -> list[float]:
    return [float(f"{value:.{DIGITS}g}") for value in values]


def _unit(vector: Vector) -> Vector:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)


def _across(vector: Vector, axis: Vector) -> Vector:
    """The part of a vector at right angles to a unit axis, unit length; any if there is none."""
    part = vector - (vector @ axis) * axis
    if float(np.linalg.norm(part)) > 1e-9 * max(1.0, float(np.linalg.norm(vector))):
        return _unit(part)
    spare = np.eye(3)[int(np.argmin(np.abs(axis)))]
    return _unit(spare - (spare @ axis) * axis)
