"""Cameras that fly around a scene, and the pictures' size."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gsynopsis.container.layout import FAR
from gsynopsis.container.notes.first_view import parse_first
from gsynopsis.records import FIRST_NOTE, ORBIT_NOTE, Frame, LevelSet
from gsynopsis.scene.camera import Camera, across, look_from, positions_of, unit

Vector = NDArray[np.float64]
DIGITS = 7
"""Significant digits of the numbers in that text."""
DEFAULT_SIZE = (960, 540)
"""Width and height of pictures without a scene, pixels."""
HEIGHT_MAX = 8192
"""Width of such images, pixels."""
DEFAULT_FOV = 60.0
"""Horizontal field of view without a scene, degrees."""
CAMERA_MARGIN = 1.1
"""The frame's extent is this times the largest distance of a camera from their mean."""
NEAR_SHARE = 0.1
"""A target nearer than this share of the cameras' spread is not what they look at."""
TILT = 20.0
"""Elevation of an orbit without a scene, degrees."""
OPEN_GAP = np.radians(75.0)
"""A circle is closed if nowhere a larger part of it is without cameras."""
ODD_CAMERAS = 30
"""One camera in so many may stand in that part all the same."""
FULL_TURN = 2 * np.pi - 1e-3
"""An arc of this many radians is a circle."""
OVERHEAD = 0.2
"""Cameras nearer to the axis than this share of the median stand at no side."""


@dataclass(frozen=True)
class Circle:
    """A round flight: where it looks, which way is up, how far and how high it flies.

    Attributes:
        target: What is looked at, world units [3].
        up: Away from the ground, unit length [3].
        ahead: Direction from the axis to the first camera, unit length, at right angles to `up`.
        radius: Distance of the cameras from the axis, world units.
        height: Height of the cameras over the target along `up`, world units.
        arc: The part of the circle that was captured, smallest and largest angle from `ahead`
            around `up`, radians; None if that is all of it.
    """

    target: Vector
    up: Vector
    ahead: Vector
    radius: float
    height: float
    arc: tuple[float, float] | None = None


def circle_of_levels(levels: LevelSet) -> Circle:
    """The circle that a file carries in its meta data, else one from its frame."""
    text = levels.meta.get(ORBIT_NOTE)
    circle = None if text is None else parse_circle(text)
    return circle or circle_of_frame(levels.frame)


def circle_text(circle: Circle) -> str:
    """A circle as the text that a file carries."""
    values = {
        name: _short(np.atleast_1d(value))
        for name, value in asdict(circle).items()
        if value is not None
    }
    return json.dumps(values, separators=(",", ":"))


def parse_circle(text: str) -> Circle | None:
    """The circle in a text of `circle_text`; None if it is not one that can be flown."""
    try:
        values = json.loads(text)
        target, up, ahead = (
            np.array(values[name], np.float64).reshape(3) for name in ("target", "up", "ahead")
        )
        radius, height = (float(values[name][0]) for name in ("radius", "height"))
        low, high = (float(angle) for angle in values.get("arc", (-np.pi, np.pi)))
    except (AttributeError, ValueError, LookupError, TypeError, OverflowError, RecursionError):
        return None
    numbers = [*target, *up, *ahead, radius, height, low, high]
    if not (np.abs(numbers) <= FAR).all() or radius < 0 or low > high or not up @ up:
        return None
    up = unit(up)
    arc = (low, high) if high - low < FULL_TURN else None
    return Circle(target, up, across(ahead, up), radius, height, arc)


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


def circle_of_cameras(
    cameras: Sequence[Camera], given: tuple[float, float, float] | None = None
) -> Circle:
    """A circle near real cameras: around the point they look at, at their mean distance.

    Up is `given`, not zero, else the mean of the cameras' own. The target is the point nearest to
    all viewing axes; where that is not in front of the cameras (parallel axes, or cameras that look
    outwards), it is a point ahead of their middle.
    """
    positions = positions_of(cameras)
    forwards = np.stack([camera.forward for camera in cameras])
    ups = -np.stack([camera.w2c[1, :3] for camera in cameras])
    up = unit(ups.mean(axis=0) if given is None else np.array(given))
    middle = positions.mean(axis=0)
    spread = float(np.linalg.norm(positions - middle, axis=1).max())
    target = nearest_to_axes(positions, forwards)
    depth = float(((target - positions) * forwards).sum(axis=1).mean())
    if depth < NEAR_SHARE * spread:
        target = middle + 2 * spread * unit(forwards.mean(axis=0))
    away = positions - target
    flat = away - (away @ up)[:, None] * up
    distances = np.linalg.norm(flat, axis=1)
    ahead, arc = captured_arc(flat[distances >= OVERHEAD * np.median(distances)], up)
    return Circle(
        target=target,
        up=up,
        ahead=across(flat[0], up) if arc is None else ahead,
        radius=float(distances.mean()),
        height=float((away @ up).mean()),
        arc=arc,
    )


def captured_arc(sides: Vector, up: Vector) -> tuple[Vector, tuple[float, float] | None]:
    """The part of a circle around `up` where cameras stand, but for a few odd ones.

    Args:
        sides: From the axis to each camera, at right angles to `up`, not zero [C, 3].
        up: The axis, unit length [3].

    Returns:
        The direction of its middle, and its angles from there, radians; None if it is closed.
    """
    ahead = across(sides[0], up)
    aside = np.cross(up, ahead)
    angles = np.sort(np.arctan2(sides @ aside, sides @ ahead))
    count = len(angles)
    # From each camera to the one after it, past the odd ones: the largest such gap is left out.
    step = min(1 + count // ODD_CAMERAS, count)
    gaps = np.concatenate([angles, angles + 2 * np.pi])[step : step + count] - angles
    before = int(gaps.argmax())
    if gaps[before] <= OPEN_GAP:
        return ahead, None
    half = float(2 * np.pi - gaps[before]) / 2
    middle = angles[before] + gaps[before] + half
    return np.cos(middle) * ahead + np.sin(middle) * aside, (-half, half)


def first_view(cameras: Sequence[Camera], circle: Circle) -> Camera:
    """The camera that shows the scene as most do: upright, at the target, mid-arc, not too near."""
    eyes = positions_of(cameras) - circle.target
    distances = np.linalg.norm(eyes, axis=1)
    forwards = np.stack([camera.forward for camera in cameras])
    downs = np.stack([camera.w2c[1, :3] for camera in cameras])
    plumb = -circle.up - (forwards @ -circle.up)[:, None] * forwards
    flat = eyes - (eyes @ circle.up)[:, None] * circle.up
    side = flat if circle.arc is None else np.broadcast_to(circle.ahead, flat.shape)
    usual = circle.radius * unit(side) + circle.height * circle.up
    far = np.log(np.maximum(distances, 1e-12) / max(float(np.median(distances)), 1e-12))
    odd = _between(forwards, -eyes) + _between(downs, plumb) + _between(eyes, usual) + np.abs(far)
    return cameras[int(odd.argmin())]


def first_text(camera: Camera) -> str:
    """The note of the first view: pose, and half of the picture's sides at a depth of 1."""
    values = {
        "w2c": _short(camera.w2c[:3].ravel()),
        "half": _short(
            np.array([camera.width / camera.fx / 2, camera.height / camera.fy / 2], np.float64)
        ),
    }
    return json.dumps(values, separators=(",", ":"))


def first_camera(meta: Mapping[str, str]) -> Camera | None:
    """The first view that a file notes, with square pixels and the usual width; None without one.

    Args:
        meta: Notes of the manifest.
    """
    view = parse_first(meta.get(FIRST_NOTE, ""))
    if view is None or not 1e-3 < view.half.min() <= view.half.max() < 1e3:
        return None
    w2c = np.concatenate([view.w2c, [[0.0, 0.0, 0.0, 1.0]]])
    if not np.allclose(w2c[:3, :3] @ w2c[:3, :3].T, np.eye(3), atol=1e-3):
        return None
    width, (across, down) = DEFAULT_SIZE[0], view.half.tolist()
    height = min(max(1, round(width * down / across)), HEIGHT_MAX)
    focal = width / 2 / across
    return Camera(width, height, focal, focal, width / 2, height / 2, w2c)


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
    """`count` cameras evenly on a round of the circle, with the size and lens of `lens`.

    Where it is open, a round goes from the middle to one end, to the other, and back.
    """
    angles = angles_of_round(circle, np.arange(count) / count)[:, None]
    sideways = np.cross(circle.up, circle.ahead)
    directions = np.cos(angles) * circle.ahead + np.sin(angles) * sideways
    eyes = circle.target + circle.radius * directions + circle.height * circle.up
    return [replace(lens, w2c=w2c) for w2c in look_from(eyes, circle.target, circle.up)]


def angles_of_round(circle: Circle, turns: Vector) -> Vector:
    """Angles from `ahead`, radians [n], at places 0 … 1 of a round [n]."""
    if circle.arc is None:
        return 2 * np.pi * turns
    low, high = circle.arc
    # Up to 1, down to -1 and back, at one speed.
    wave = 1 - np.abs(4 * ((turns + 0.25) % 1.0) - 2)
    return (low + high) / 2 + (high - low) / 2 * wave


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


def _between(one: Vector, other: Vector) -> Vector:
    """Angles between vectors, radians, both [C, 3]."""
    return np.arccos(np.clip((unit(one) * unit(other)).sum(axis=1), -1, 1))
