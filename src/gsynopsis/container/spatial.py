"""Spatial blocks of the anchors of each level, as a writer makes them.

All anchors, whatever level brought them, stand on one Morton curve. A block is an interval of it;
the intervals of level k divide those of level k − 1. The base's intervals are put into the order in
which the first view needs them.
"""

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gsynopsis.container.notes.first_view import parse_first
from gsynopsis.records import FIRST_NOTE, MORTON_BITS, LevelSet, morton_codes, morton_order

BLOCK_ANCHORS = 16384
"""A block of more anchors is cut in two."""
BASE_ANCHORS = 2048
"""One of the base too: a slow line shows something before all of the base is there."""
LEAST_PART = 3
"""A cut leaves at least one part in this many on either side."""

Int64 = NDArray[np.int64]


@dataclass(frozen=True)
class LevelBlocks:
    """The blocks of one level, as intervals of the Morton curve.

    Attributes:
        parent: Block of the level before, int64 [B].
        rows: Anchors of a block by the level that brought them, int64 [B, level + 1].
    """

    parent: Int64
    rows: Int64


def sorted_levels(
    levels: LevelSet, size: int = BLOCK_ANCHORS, base: int = BASE_ANCHORS
) -> LevelSet:
    """The same set with the new anchors of each level in the order of the blocks.

    The base's blocks stand in the order in which the first view needs them if the notes name one,
    and their anchors on the curve. The set itself if it already is in that order; else a copy with
    other rows.

    Args:
        levels: Any set.
        size: Largest number of anchors of a block, at least 2.
        base: The same for a block of the base, if that is less.
    """
    shared, counts = levels.shared, [level.anchors for level in levels.levels]
    order = morton_order(shared.lattice)
    first = np.searchsorted(counts, order, side="right")
    bounds = _base_bounds(shared.lattice[order], first, min(size, base))
    view = parse_first(levels.meta.get(FIRST_NOTE, ""))
    if view is not None:
        points = shared.lattice[order] * np.float64(levels.frame.voxel)
        seen = np.where(first == 0, view.weights(points), 0.0)
        spans = list(itertools.pairwise(bounds))
        worth = [seen[a:b].sum() / max(1, int((first[a:b] == 0).sum())) for a, b in spans]
        ranks = np.argsort(-np.array(worth), kind="stable")
        places = _joined(bounds, ranks)
        order, first = order[places], first[places]
    order = order[np.argsort(first, kind="stable")]
    if (order == np.arange(len(order))).all():
        return levels
    inner = tuple(replace(v, mask=v.mask[order[: v.anchors]]) for v in levels.levels)
    return LevelSet(levels.frame, shared.of_rows(order), inner, levels.meta)


def blocks_of_levels(
    levels: LevelSet, size: int = BLOCK_ANCHORS, base: int = BASE_ANCHORS
) -> list[LevelBlocks]:
    """The blocks of every level, coarsest first, each of at most `size` anchors.

    Args:
        levels: What `sorted_levels` gives for the same sizes.
        size: Largest number of anchors of a block, at least 2.
        base: The same for a block of the base, if that is less.
    """
    lattice = levels.shared.lattice
    order = morton_order(lattice)
    counts = [level.anchors for level in levels.levels]
    first = np.searchsorted(counts, order, side="right")
    codes = _cells(lattice[order])
    bounds = _base_bounds(lattice[order], first, min(size, base))
    # The base's blocks come in the order of its anchors' rows.
    own = np.where(first == 0, order, len(order))
    ranks = np.argsort([own[a:b].min(initial=len(order)) for a, b in itertools.pairwise(bounds)])
    places = _joined(bounds, ranks)
    codes, first = codes[places], first[places]
    bounds = np.concatenate([[0], np.cumsum(np.diff(bounds)[ranks])])
    found = [
        LevelBlocks(np.zeros(len(ranks), np.int64), _per_interval(first == 0, bounds)[:, None])
    ]
    for number in range(1, len(counts)):
        present = np.flatnonzero(first <= number)
        edges = np.searchsorted(present, bounds)
        finer: list[int] = [0]
        parent: list[int] = []
        for block, (start, end) in enumerate(itertools.pairwise(edges)):
            splits = _splits(codes[present], int(start), int(end), size)
            inner = [int(present[at]) for at in splits]
            finer += [*inner, int(bounds[block + 1])]
            parent += [block] * (len(inner) + 1)
        bounds = np.array(finer, np.int64)
        rows = [_per_interval(first == k, bounds) for k in range(number + 1)]
        found.append(LevelBlocks(np.array(parent, np.int64), np.stack(rows, axis=1)))
    return found


def _base_bounds(points: NDArray[np.int32], first: Int64, size: int) -> Int64:
    """Bounds of the intervals of the base's blocks among points on the curve."""
    present = np.flatnonzero(first == 0)
    splits = _splits(_cells(points)[present], 0, len(present), size)
    return np.array([0, *present[splits], len(points)], np.int64)


def _joined(bounds: Int64, ranks: Int64) -> Int64:
    """Places of an array whose intervals are put into another order."""
    edges = [int(bound) for bound in bounds]
    return np.concatenate([np.arange(edges[rank], edges[rank + 1]) for rank in map(int, ranks)])


def _per_interval(chosen: NDArray[np.bool_], bounds: Int64) -> Int64:
    total = np.concatenate([[0], np.cumsum(chosen)])
    return np.diff(total[bounds])


def _cells(points: NDArray[np.int32]) -> NDArray[np.uint64]:
    """Morton codes of points in order, without the lowest bits of a very wide lattice."""
    if not len(points):
        return np.zeros(0, np.uint64)
    local = points.astype(np.int64) - points.min(axis=0)
    extra = max(0, int(local.max()).bit_length() - MORTON_BITS)
    return morton_codes((local >> extra).astype(np.uint64))


def _splits(codes: NDArray[np.uint64], start: int, end: int, size: int) -> list[int]:
    """Cuts of codes[start:end]: near the middle, between the largest cells there are."""
    count = end - start
    if count <= size:
        return []
    margin = max(1, count // LEAST_PART)
    first = start + margin
    steps = codes[first : end - margin + 1] ^ codes[first - 1 : end - margin]
    at = first + int(np.argmax(steps))
    return [*_splits(codes, start, at, size), at, *_splits(codes, at, end, size)]
