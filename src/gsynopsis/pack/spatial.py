"""Spatial blocks of the anchors of each level, as a writer makes them.

All anchors, whatever level brought them, stand on one Morton curve. A block is an interval of it;
the intervals of level k divide those of level k − 1.
"""

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gsynopsis.records import MORTON_BITS, LevelSet, morton_codes, morton_order

BLOCK_ANCHORS = 16384
"""A block of more anchors is cut in two."""
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


def sorted_levels(levels: LevelSet) -> LevelSet:
    """The same set with the new anchors of each level in the Morton order of all anchors.

    The set itself if it already is; else a copy with other rows.
    """
    shared, counts = levels.shared, [level.anchors for level in levels.levels]
    order = morton_order(shared.lattice)
    first = np.searchsorted(counts, order, side="right")
    order = order[np.argsort(first, kind="stable")]
    if (order == np.arange(len(order))).all():
        return levels
    moved = replace(
        shared,
        lattice=shared.lattice[order],
        log_scales=shared.log_scales[order],
        offsets=shared.offsets[order],
        codes=shared.codes[order] if len(shared.codes) else shared.codes,
        residual=shared.residual[order],
    )
    inner = tuple(replace(v, mask=v.mask[order[: v.anchors]]) for v in levels.levels)
    return LevelSet(levels.frame, moved, inner, levels.meta)


def blocks_of_levels(levels: LevelSet, size: int = BLOCK_ANCHORS) -> list[LevelBlocks]:
    """The blocks of every level, coarsest first, each of at most `size` anchors.

    Args:
        levels: New anchors of each level in Morton order, see `sorted_levels`.
        size: Largest number of anchors, at least 2.
    """
    lattice = levels.shared.lattice
    order = morton_order(lattice)
    counts = [level.anchors for level in levels.levels]
    first = np.searchsorted(counts, order, side="right")
    codes = _cells(lattice[order])
    bounds = np.array([0, len(order)], np.int64)
    found: list[LevelBlocks] = []
    for number in range(len(counts)):
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
    """Where to cut codes[start:end]: near the middle, between the largest cells there are."""
    count = end - start
    if count <= size:
        return []
    margin = max(1, count // LEAST_PART)
    first = start + margin
    steps = codes[first : end - margin + 1] ^ codes[first - 1 : end - margin]
    at = first + int(np.argmax(steps))
    return [*_splits(codes, start, at, size), at, *_splits(codes, at, end, size)]
