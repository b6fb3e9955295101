"""Anchors as integer multiples of the voxel: initial cells, keys, growth cells."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from torch import Tensor

Cells = TypeVar("Cells", NDArray[np.int64], Tensor)
KEY_LIMIT = 1 << 20
"""Lattice coordinates lie in [-KEY_LIMIT, KEY_LIMIT): 21 bits an axis fit one int64 key."""


def auto_voxel(points: NDArray[np.float64], extent: float = 1.0) -> float:
    """Median distance of a point to its nearest other point, world units, > 0.

    Ours (methods.md §1.2): the predecessors take a median *squared* distance, whose unit is wrong.

    Args:
        points: [P, 3], none far outside of the others.
        extent: Of the scene, world units: decides alone where no two points differ.
    """
    distances, _ = KDTree(points).query(points, k=2)
    nearest = distances[:, 1]
    positive = nearest[(nearest > 0) & np.isfinite(nearest)]
    if len(positive) == 0:
        return extent / 1024
    return max(float(np.median(positive)), least_voxel(points))


def least_voxel(points: NDArray[np.float64]) -> float:
    """The finest lattice that 21 bits an axis can hold for points [P, 3], world units, ≥ 0."""
    return float(np.ptp(points, axis=0).max()) / KEY_LIMIT if len(points) else 0.0


def initial_lattice(points: NDArray[np.float64], voxel: float) -> NDArray[np.int64]:
    """The occupied cells of a point cloud, unique and sorted, int64 [N, 3].

    Points beyond the lattice are left out, see `beyond_lattice`.
    """
    cells = _cells(points, voxel)
    inside = (np.abs(cells) < KEY_LIMIT).all(axis=1)
    return np.unique(cells[inside].astype(np.int64), axis=0)


def beyond_lattice(points: NDArray[np.float64], voxel: float) -> int:
    """Number of points that lie too many cells from the origin for a key."""
    return int((np.abs(_cells(points, voxel)) >= KEY_LIMIT).any(axis=1).sum())


def _cells(points: NDArray[np.float64], voxel: float) -> NDArray[np.float64]:
    with np.errstate(over="ignore"):
        return np.round(points / voxel)


def initial_log_scales(positions: NDArray[np.float64], voxel: float) -> NDArray[np.float32]:
    """Log √(mean squared distance to the 3 nearest anchors), copied to 6 columns (§1.2.4)."""
    count = len(positions)
    if count < 2:
        return np.full((count, 6), np.log(voxel), dtype=np.float32)
    near = min(3, count - 1)
    distances, _ = KDTree(positions).query(positions, k=near + 1)
    squared = (distances[:, 1:] ** 2).mean(axis=1)
    log_scale = 0.5 * np.log(np.maximum(squared, 1e-7 * min(1.0, voxel * voxel)))
    return np.repeat(log_scale[:, None], 6, axis=1).astype(np.float32)


def lattice_keys(lattice: Cells) -> Cells:
    """One int64 per cell of an array or tensor [N, 3], equal exactly for equal cells, [N].

    Coordinates lie within ±KEY_LIMIT.
    """
    shifted = lattice + KEY_LIMIT
    return (shifted[:, 0] << 42) | (shifted[:, 1] << 21) | shifted[:, 2]


def growth_cells(lattice: NDArray[np.int64], cell: int) -> NDArray[np.int64]:
    """The growth cell of each anchor, half to even, int64 [N, 3].

    Args:
        lattice: Anchors, in voxels, int64 [N, 3].
        cell: Edge of a growth cell, voxels. Cell c is around the node c · cell.
    """
    return np.round(lattice / cell).astype(np.int64)


def free_cells(
    candidates: NDArray[np.int64], occupied: NDArray[np.int64], limit: int = KEY_LIMIT
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Distinct candidate cells that are not occupied.

    Args:
        candidates: Cells, int64 [M, 3], repeats allowed.
        occupied: Cells that are taken, int64 [N, 3], repeats allowed.
        limit: Candidates with a coordinate of this or more, either way, are never free.

    Returns:
        The free cells, int64 [P, 3] in key order, and for each candidate its row among them or
        -1, int64 [M].
    """
    inside: NDArray[np.bool_] = np.all(np.abs(candidates) < limit, axis=1)
    keys = lattice_keys(np.where(inside[:, None], candidates, 0))
    unique, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    taken = np.isin(unique, lattice_keys(occupied))
    taken |= ~np.isin(np.arange(len(unique)), inverse[inside])
    row_of = np.where(taken, -1, np.cumsum(~taken) - 1)
    rows = np.where(inside, row_of[inverse], -1)
    return candidates[first[~taken]], rows
