"""Points for regions without sparse points: sky, plain walls, a studio's backdrop.

Structure from motion finds no points there. A model that starts from points alone has nothing there
either, and the cheapest way to paint it is a veil right before the cameras, behind which the scene
itself is lost (ours, methods.md §2.16).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gsynopsis.scene.camera import Camera, positions_of

CELLS = 12
"""Cells along the longer side of a photo: one without a point in it shows backdrop, perhaps."""
BINS = 12
"""Directions are binned in steps of 1/12 radian."""
SHARE = 1 / 3
"""Share of a direction's cells without a point from which on the direction counts as backdrop."""
FAR = 3.0
"""Radius of the shell, in distances of the farthest things and cameras from the middle."""
MOST_POINTS = 30_000
"""Most points that are used; of more, every second, third and so on."""
FARTHEST = 0.98
"""Quantile of the points' distances that counts as that of the farthest thing."""


def backdrop_points(
    cameras: Sequence[Camera], points: NDArray[np.float64], extent: float
) -> NDArray[np.float64]:
    """Points of a far shell around a scene, where photos show what has no points.

    Args:
        cameras: Of the photos, at least one.
        points: Sparse points, [P, 3].
        extent: Of the scene, world units.

    Returns:
        World positions, from none (all is covered) to some 1,800, [B, 3].
    """
    eyes = positions_of(cameras)
    middle = eyes.mean(axis=0)
    reach = [np.linalg.norm(eyes - middle, axis=1).max(), extent]
    if len(points):
        away = np.linalg.norm(points - middle, axis=1)
        reach.append(np.quantile(away, FARTHEST))
    radius = FAR * float(max(reach))
    points = points[:: max(1, -(-len(points) // MOST_POINTS))]
    bins, bare = list[NDArray[np.int64]](), list[NDArray[np.bool_]]()
    for camera in cameras:
        directions, covered = _cells(camera, points)
        places = _on_sphere(camera.position - middle, directions, radius)
        bins.append(np.rint(places / radius * BINS).astype(np.int64))
        bare.append(~covered)
    found, which = np.unique(np.concatenate(bins), axis=0, return_inverse=True)
    seen = np.bincount(which.ravel(), minlength=len(found))
    open_ = np.bincount(which.ravel(), np.concatenate(bare), minlength=len(found))
    chosen = found[open_ >= SHARE * seen].astype(np.float64)
    return middle + radius * chosen / np.linalg.norm(chosen, axis=1, keepdims=True)


def _cells(
    camera: Camera, points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Unit directions through the middles of a photo's cells, [C, 3], and which hold a point."""
    size = max(camera.width, camera.height) / CELLS
    columns, rows = (max(1, round(side / size)) for side in (camera.width, camera.height))
    x = (np.arange(columns) + 0.5) * camera.width / columns
    y = (np.arange(rows) + 0.5) * camera.height / rows
    pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    local = np.ones((len(pixels), 3))
    local[:, 0] = (pixels[:, 0] - camera.cx) / camera.fx
    local[:, 1] = (pixels[:, 1] - camera.cy) / camera.fy
    world = local @ camera.w2c[:3, :3]
    covered = np.zeros(rows * columns, np.bool_)
    framed = camera.framed(points)
    column = (framed.columns / camera.width * columns).astype(np.int64)
    row = (framed.rows / camera.height * rows).astype(np.int64)
    covered[row * columns + column] = True
    return world / np.linalg.norm(world, axis=1, keepdims=True), covered


def _on_sphere(
    origin: NDArray[np.float64], directions: NDArray[np.float64], radius: float
) -> NDArray[np.float64]:
    """Points where rays from inside a sphere around zero leave it, [C, 3]."""
    along = directions @ origin
    return origin + directions * (np.sqrt(along**2 + radius**2 - origin @ origin) - along)[:, None]
