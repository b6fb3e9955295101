"""Up direction and centre of a reconstruction, to which its world is aligned."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gsynopsis.scene.camera import Camera, positions_of

AGREED = 0.5
"""Length of the mean of the photos' upward directions from which they tell where up is."""
PARALLEL = 0.05
"""Viewing axes whose mean direction differs by less than this have no point that all look at."""


def up_of(cameras: Sequence[Camera]) -> NDArray[np.float64]:
    """The direction away from the ground, unit length [3].

    The mean of the photos' own upward directions; where they do not agree, as in photos taken
    straight down on several courses, the direction opposite to where all look.
    """
    ups = -np.stack([camera.w2c[1, :3] for camera in cameras])
    backs = -np.stack([camera.forward for camera in cameras])
    up, back = ups.mean(axis=0), backs.mean(axis=0)
    chosen = up if np.linalg.norm(up) >= min(AGREED, float(np.linalg.norm(back))) else back
    length = float(np.linalg.norm(chosen))
    return chosen / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])


def scene_center(cameras: Sequence[Camera], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The point nearest to all viewing axes, where it is in front of the cameras, [3].

    Elsewhere the median of the points [P, 3].
    """
    places = positions_of(cameras)
    axes = np.stack([camera.forward for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]  # [C, 3, 3]
    system: NDArray[np.float64] = across.mean(axis=0)
    if np.linalg.eigvalsh(system)[0] > PARALLEL**2:
        right: NDArray[np.float64] = (across @ places[:, :, None])[:, :, 0].mean(axis=0)
        middle = np.linalg.solve(system, right)
        if float(((middle - places) * axes).sum(axis=1).min()) > 0:
            return middle.astype(np.float64)
    return np.median(points, axis=0).astype(np.float64)


def upright(
    cameras: Sequence[Camera],
    points: NDArray[np.float64],
    up: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """A rigid motion of the world that puts its middle at the origin and up along z, [3, 4].

    Args:
        cameras: All of them.
        points: Sparse points, [P, 3].
        up: Away from the ground, not zero [3]; None: see `up_of`.
    """
    z = up_of(cameras) if up is None else np.asarray(up, np.float64) / np.linalg.norm(up)
    ahead = np.stack([camera.forward for camera in cameras]).mean(axis=0)
    y = ahead - (ahead @ z) * z
    if np.linalg.norm(y) < 1e-6:
        y = np.cross(z, np.eye(3)[int(np.abs(z).argmin())])
    y /= np.linalg.norm(y)
    rotation = np.stack([np.cross(y, z), y, z])
    shift = -rotation @ scene_center(cameras, points)
    return np.hstack([rotation, shift[:, None]]).astype(np.float64)
