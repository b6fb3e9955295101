"""Splats that lie together, a few in each cluster: what an anchor and its slots begin as.

Letters: G splats, N clusters, K slots.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gsynopsis.model.lattice import KEY_LIMIT, lattice_keys

Int64 = NDArray[np.int64]
Float64 = NDArray[np.float64]
CELL = 0.25
"""Edge of a lattice cell to how far a cluster usually reaches."""
AROUND = 8
"""Cells each way around a taken one that are tried."""
NEAREST = 26
"""Neighbours that are tried first: it is seldom that none of them is free."""


class Clusters(NamedTuple):
    """Splats by cluster.

    Attributes:
        lattice: Cell of each cluster, unique, sorted as `np.unique` sorts rows, int64 [N, 3].
        members: Rows of the splats in each cluster, -1 where there are fewer, int64 [N, K].
    """

    lattice: Int64
    members: Int64


def clustered(points: Float64, capacity: int) -> tuple[Int64, int]:
    """The cluster of each point, int64 [G], and how many clusters there are.

    A k-d tree: parts are halved about at the median of their longest side until each has no more
    than `capacity` points. All clusters but one are full: a slot that nothing uses is still a bit
    of each mask.

    Args:
        points: [G, 3].
        capacity: Points of a cluster at most, ≥ 1.
    """
    label = np.zeros(len(points), np.int64)
    parts, count = [np.arange(len(points))], 0
    while parts:
        halves: list[Int64] = []
        for part in parts:
            if len(part) <= capacity:
                label[part] = count
                count += 1
                continue
            axis = int(np.ptp(points[part], axis=0).argmax())
            middle = capacity * -(-len(part) // (2 * capacity))
            order = np.argsort(points[part, axis], kind="stable")
            halves += [np.sort(part[order[:middle]]), np.sort(part[order[middle:]])]
        parts = halves
    return label, count


def lattice_cell(points: Float64, label: Int64, count: int) -> float:
    """A lattice cell, world units, on which most clusters have one of their own.

    Args:
        points: [G, 3].
        label: Cluster of each [G].
        count: N.
    """
    extent = float(np.abs(points).max())
    return max(CELL * reach_of(points, label, count), 2 * extent / KEY_LIMIT)


def reach_of(points: Float64, label: Int64, count: int) -> float:
    """Usual distance of a cluster's points from their mean along an axis, > 0."""
    sums = [np.bincount(label, points[:, axis], count) for axis in range(3)]
    means = np.stack(sums, axis=1) / np.bincount(label, minlength=count)[:, None]
    reach = np.zeros(count)
    np.maximum.at(reach, label, np.abs(points - means[label]).max(axis=1))
    return max(float(np.median(reach)), 1e-12)


def clusters_of(
    points: Float64, weights: Float64, label: Int64, count: int, voxel: float, slots: int
) -> Clusters:
    """Clusters on the lattice: each at the cell of its weighted mean, or at a free one beside it.

    Of more clusters in one place than there are cells around it the last are left out.

    Args:
        points: [G, 3], world units.
        weights: Of each point in the mean of its cluster, [G] ≥ 0.
        label: Cluster of each point [G].
        count: N.
        voxel: Lattice cell, world units.
        slots: K, at least the points of the largest cluster.
    """
    weight = weights + 1e-12 * max(float(weights.max(initial=0.0)), 1e-300)
    total = np.bincount(label, weight, count)
    sums = [np.bincount(label, weight * points[:, axis], count) for axis in range(3)]
    means = np.stack(sums, axis=1) / total[:, None]
    cells = np.clip(np.round(means / voxel), 1 - KEY_LIMIT, KEY_LIMIT - 1).astype(np.int64)
    members = np.full((count, slots), -1, np.int64)
    by_label = np.argsort(label, kind="stable")
    sizes = np.bincount(label, minlength=count)
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    place = np.arange(len(label)) - np.repeat(starts, sizes)
    members[label[by_label], place] = by_label
    cells, placed = apart(cells)
    cells, members = cells[placed], members[placed]
    order = np.lexsort((cells[:, 2], cells[:, 1], cells[:, 0]))
    return Clusters(cells[order], members[order])


def apart(cells: Int64) -> tuple[Int64, NDArray[np.bool_]]:
    """The cells [N, 3], and which of them are unique now, [N].

    Of equal ones the first stays, each other one moves to the nearest free one around it.
    """
    cells = cells.copy()
    _, first = np.unique(lattice_keys(cells), return_index=True)
    unique = np.zeros(len(cells), np.bool_)
    unique[first] = True
    taken = set(lattice_keys(cells[first]).tolist())
    steps = _steps()
    for row in np.flatnonzero(~unique).tolist():
        for some in (steps[:NEAREST], steps[NEAREST:]):
            near = np.clip(cells[row] + some, 1 - KEY_LIMIT, KEY_LIMIT - 1)
            keys = lattice_keys(near).tolist()
            free = next((n for n, key in enumerate(keys) if key not in taken), None)
            if free is not None:
                cells[row], unique[row] = near[free], True
                taken.add(keys[free])
                break
    return cells, unique


def _steps() -> Int64:
    """Steps to cells around one, the nearest first, int64 [n, 3]."""
    side = np.arange(-AROUND, AROUND + 1)
    steps = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)
    return steps[np.argsort((steps**2).sum(axis=1), kind="stable")[1:]]
