"""Known part of a file whose directories are in pages, and the page to request next.

Without any of its pages, a region is known only as the block that its page divides, or, before the
base is there, as the page itself.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gsynopsis.container import Assembler
from gsynopsis.container.directory import Directory

Int64 = NDArray[np.int64]
UNKNOWN = -1
"""In place of a block's number."""


class Leaves(NamedTuple):
    """The smallest regions that can differ in level, as far as they are known.

    Attributes:
        lineage: For each level the block that holds each leaf, or `UNKNOWN`, int64 [R] each.
        low: Corner of each leaf's box, world units [R, 3].
        high: The opposite corner.
    """

    lineage: list[Int64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


def leaves_of(assembler: Assembler, levels: int) -> Leaves:
    """The leaves of a file's first levels, whose directories or page tables are there."""
    directories = {level: assembler.directories[level] for level in range(levels)}
    voxel = assembler.index.header.voxel
    if not assembler.index.paged:
        return Leaves(ancestors(directories), *boxes(directories[levels - 1].records, voxel))
    table = assembler.pages[0]
    lacking = np.flatnonzero(~assembler.held_pages(0))
    lineage = [[np.full(len(lacking), UNKNOWN)] for _ in range(levels)]
    corners = [boxes(table.records[lacking], voxel)]
    for level in range(levels):
        blocks = known_blocks(assembler, level)
        if level + 1 < levels:
            finer = assembler.pages[level + 1]
            page = np.searchsorted(finer.parents, blocks, side="right") - 1
            blocks = blocks[~assembler.held_pages(level + 1)[page]]
        corners.append(boxes(directories[level].records[blocks], voxel))
        for above in range(level, -1, -1):
            lineage[above].append(blocks)
            blocks = directories[above].records["parent"][blocks].astype(np.int64)
        for below in range(level + 1, levels):
            lineage[below].append(np.full(len(lineage[level][-1]), UNKNOWN))
    low, high = (np.concatenate(corner) for corner in zip(*corners, strict=True))
    return Leaves([np.concatenate(level) for level in lineage], low, high)


def known_blocks(assembler: Assembler, level: int) -> Int64:
    """Numbers of the blocks whose records are there."""
    if not assembler.index.paged:
        return np.arange(len(assembler.directories[level]))
    held = assembler.held_pages(level)
    return np.flatnonzero(np.repeat(held, np.diff(assembler.pages[level].first)))


def ancestors(directories: Mapping[int, Directory]) -> list[Int64]:
    """For each level, the block that holds each leaf; leaves are the finest level's blocks."""
    last = len(directories) - 1
    lineage = [np.arange(len(directories[last]))]
    for level in range(last, 0, -1):
        parents = directories[level].records["parent"].astype(np.int64)
        lineage.append(parents[lineage[-1]])
    return lineage[::-1]


def boxes(
    records: NDArray[np.void], voxel: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corners of the cells of blocks' or pages' anchors, world units [B, 3] each."""
    low = np.stack([records[f"low_{axis}"] for axis in "xyz"], axis=1)
    high = np.stack([records[f"high_{axis}"] for axis in "xyz"], axis=1)
    return (low - 0.5) * voxel, (high + 0.5) * voxel


def grouped(lineage: Int64, count: int) -> list[Int64]:
    """The leaves of each block of a level, ascending, from the block of each leaf."""
    order = np.argsort(lineage, kind="stable")
    return np.split(order, np.searchsorted(lineage[order], np.arange(count + 1)))[1:-1]
