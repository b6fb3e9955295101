"""Cameras as a policy sees them: how much of the picture each region takes, now and soon."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]
POINTS = 4
"""Sample points per axis of a region's box."""
LEAK = 0.005
"""Share of the picture that comes from boxes that seem not to be in it (ours)."""


@dataclass(frozen=True)
class Eye:
    """A pinhole camera without pixels.

    Attributes:
        w2c: World to camera, OpenCV axes, float64 [4, 4].
        right: Tangent of half the horizontal field of view.
        up: Tangent of half the vertical one.
    """

    w2c: Float64
    right: float
    up: float


def covered(low: Float64, high: Float64, eye: Eye) -> Float64:
    """The share of the picture that each region's box covers, [R]; sums to 1 if any is seen.

    Boxes hide one another and overlap; each counts with what it would cover alone. A box is cut
    into `POINTS`³ parts, each of which counts with the picture that it covers, the margin included
    that lies outside. `LEAK` of the picture is shared out among all boxes: what a Gaussian covers
    may lie far from its box. Boxes are those of anchors, which say more of where a block is seen
    than those of all that its largest Gaussian reaches.

    Args:
        low: Corners of boxes, world units [R, 3].
        high: Opposite corners [R, 3].
        eye: The camera.
    """
    seen = _samples(low, high, eye)
    half = np.linalg.norm(high - low, axis=1)[:, None] / (2 * POINTS * np.sqrt(3.0)) + 1e-9
    z = np.maximum(seen[..., 2], half)
    area = _overlap(seen[..., 0], half, z * eye.right) * _overlap(seen[..., 1], half, z * eye.up)
    # Parts lie behind one another, `POINTS` deep.
    area = np.minimum(np.where(seen[..., 2] > -half, area, 0.0).sum(axis=1) / POINTS, 1.0)
    total = float(area.sum())
    if total <= 0:
        return area
    return (1 - LEAK) * area / total + LEAK / len(area)


def _samples(low: Float64, high: Float64, eye: Eye) -> Float64:
    """Centres of the `POINTS`³ parts of each box, seen from the camera, [R, P, 3]."""
    steps = (np.arange(POINTS) + 0.5) / POINTS
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    points = low[:, None, :] + grid[None] * (high - low)[:, None, :]
    return points @ eye.w2c[:3, :3].T + eye.w2c[:3, 3]


def _overlap(center: Float64, half: Float64, edge: Float64) -> Float64:
    """Share of [-edge, edge] that intervals around centres cover, 0 to 1."""
    right = np.minimum((center + half) / edge, 1.0)
    return np.maximum(right - np.maximum((center - half) / edge, -1.0), 0.0) / 2


def covered_over(low: Float64, high: Float64, eyes: Sequence[Eye]) -> Float64:
    """`covered` for several cameras, [T, R]."""
    return np.stack([covered(low, high, eye) for eye in eyes])


def extrapolated(before: Eye, now: Eye, step: float, times: Sequence[float]) -> list[Eye]:
    """Where a camera will be if it goes on moving as between two moments.

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
    eyes: list[Eye] = []
    for time in times:
        w2c = np.eye(4)
        w2c[:3, :3] = _rotation(axis, angle * time / step) @ now.w2c[:3, :3]
        w2c[:3, 3] = -w2c[:3, :3] @ (place + (place - last) * (time / step))
        eyes.append(Eye(w2c, now.right, now.up))
    return eyes


def _position(eye: Eye) -> Float64:
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
