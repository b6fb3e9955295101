"""Cameras as a policy sees them: how much of the image each region takes, now and soon."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
POINTS, FEWER_POINTS = 4, 2
"""Sample points per axis of a region's box; the second where there are more boxes than `MANY`, of
which each takes little of an image."""
MANY = 1024
LEAK = 0.005
"""Share of the image that comes from boxes that seem not to be in it (ours)."""


@dataclass(frozen=True)
class ViewPose:
    """A pinhole camera without pixels.

    Attributes:
        w2c: World to camera, OpenCV axes, float64 [4, 4].
        right: Tangent of half the horizontal field of view.
        up: Tangent of half the vertical one.
    """

    w2c: Float64
    right: float
    up: float


def covered(low: Float64, high: Float64, eye: ViewPose) -> Float64:
    """The share of the image that each region's box covers, [R]; sums to 1 if any is seen.

    Boxes hide one another and overlap; each counts with its own area, unoccluded. A box is cut into
    `POINTS`³ parts, each of which counts with the image that it covers, the margin outside
    included. `LEAK` of the image is shared out among all boxes, for a Gaussian may cover pixels far
    from its box. Boxes are those of anchors, which locate a block in the image better than boxes of
    all that its largest Gaussian reaches.

    Args:
        low: Corners of boxes, world units [R, 3].
        high: Opposite corners [R, 3].
        eye: The camera.
    """
    return covered_by(parts_of(low, high), eye)


class Parts(NamedTuple):
    """Camera-independent part of `covered`: boxes cut into parts.

    Attributes:
        points: Centres of the `side`³ parts of each box, homogeneous, world units [4, R * P].
        half: Half the side of a part, world units [R * P].
        side: Parts per axis; P is its cube.
    """

    points: Float64
    half: Float64
    side: int


def parts_of(low: Float64, high: Float64) -> Parts:
    """The parts of boxes; arguments as of `covered`."""
    side = POINTS if len(low) <= MANY else FEWER_POINTS
    steps = (np.arange(side) + 0.5) / side
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    points = (low[:, None, :] + grid[None] * (high - low)[:, None, :]).reshape(-1, 3)
    half = np.linalg.norm(high - low, axis=1) / (2 * side * np.sqrt(3.0)) + 1e-9
    return Parts(np.vstack([points.T, np.ones(len(points))]), np.repeat(half, side**3), side)


def covered_by(parts: Parts, eye: ViewPose) -> Float64:
    """See `covered`."""
    points, half, side = parts
    x, y, depth = eye.w2c[:3] @ points
    z = np.maximum(depth, half)
    area = _overlap(x, half, z * eye.right) * _overlap(y, half, z * eye.up)
    # Parts lie behind one another, `side` deep.
    seen = np.where(depth > -half, area, 0.0).reshape(-1, side**3).sum(axis=1)
    area = np.minimum(seen / side, 1.0)
    total = float(area.sum())
    if total <= 0:
        return area
    return (1 - LEAK) * area / total + LEAK / len(area)


def _overlap(center: Float64, half: Float64, edge: Float64) -> Float64:
    """Share of [-edge, edge] that intervals around centres cover, 0 to 1."""
    right = np.minimum((center + half) / edge, 1.0)
    return np.maximum(right - np.maximum((center - half) / edge, -1.0), 0.0) / 2


def extrapolate(
    before: ViewPose, now: ViewPose, step: float, times: Sequence[float]
) -> list[ViewPose]:
    """Camera poses ahead, if the camera goes on moving as between two moments.

    Position and rotation go on at constant speed.

    Args:
        before: The camera `step` seconds ago.
        now: The camera now.
        step: Seconds, > 0.
        times: Seconds from now, each at least 0.
    """
    turn = now.w2c[:3, :3] @ before.w2c[:3, :3].T
    axis, angle = _axis_angle(turn)
    place, last = _position(now), _position(before)
    eyes: list[ViewPose] = []
    for time in times:
        w2c = np.eye(4)
        w2c[:3, :3] = _rotation(axis, angle * time / step) @ now.w2c[:3, :3]
        w2c[:3, 3] = -w2c[:3, :3] @ (place + (place - last) * (time / step))
        eyes.append(ViewPose(w2c, now.right, now.up))
    return eyes


def _position(eye: ViewPose) -> Float64:
    return -eye.w2c[:3, :3].T @ eye.w2c[:3, 3]


def _axis_angle(rotation: Float64) -> tuple[Float64, float]:
    """Unit axis and angle in [0, π] of a rotation matrix."""
    skew = np.array(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )
    length = float(np.linalg.norm(skew))
    angle = float(np.arctan2(length, np.trace(rotation) - 1))
    return (skew / length if length > 1e-12 else np.array([0.0, 0.0, 1.0])), angle


def _rotation(axis: Float64, angle: float) -> Float64:
    """Rodrigues' formula, [3, 3]."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)
