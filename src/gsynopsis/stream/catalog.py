"""Items that a client can request: ranges of a file, items needed first, the error each removes.

A catalog knows nothing of how bytes become images. Ours comes from a file's index and directories;
those of other layouts (whole levels, separate files, other methods) are a list of sizes, so that
all are compared by the same session and the same policies.
"""

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gsynopsis.container import Assembler
from gsynopsis.container.layout import ChunkEntry, Kind
from gsynopsis.container.notes.block_utility import parse_utility
from gsynopsis.records import UTILITY_NOTE
from gsynopsis.stream.paged import UNKNOWN, Leaves, grouped, known_blocks, leaves_of
from gsynopsis.stream.views import Parts, parts_of

SHARED = -1
"""In place of a block's number: what all blocks of a level need."""
PAGES = -2
"""In place of a block's number: the first page of a level's directory; others are below it."""
DB_MAX = 300.0
"""Figures of a file are limited to this, either way: files come from untrusted sources."""
FULL_DB = 50.0
"""PSNR against the full model above which differences are invisible, dB (ours)."""
STEP_DB = 4.0
"""Assumed gain of a level if a file carries no quality, dB (ours)."""


def nowhere() -> NDArray[np.int64]:
    """No leaves."""
    return np.zeros(0, np.int64)


class Key(NamedTuple):
    """Name of an item: its level and block, or `SHARED`, or a page, see `PAGES`."""

    level: int
    block: int


class Part(NamedTuple):
    """One chunk, block or page of the file: the smallest thing that is checked.

    `block` as in `Key`. What stands behind a page that came is known from then on.
    """

    start: int
    stop: int
    chunk: ChunkEntry | None
    level: int
    block: int


@dataclass(frozen=True)
class Item:
    """A range that is asked for as one.

    Attributes:
        key: Its name.
        start: First byte.
        stop: End of the range.
        needs: Items without which it is of no use, in the order to ask for them.
        region: Leaves (see `Catalog`) that it brings to its level, int64 [n]; may be empty.
        slots: Gaussian slots that it adds, for a device's budget.
        parts: Its chunks and blocks, in order; empty if nothing is decoded.
    """

    key: Key
    start: int
    stop: int
    needs: tuple[Key, ...] = ()
    region: NDArray[np.int64] = field(default_factory=nowhere)
    slots: int = 0
    parts: tuple[Part, ...] = ()

    @property
    def size(self) -> int:
        """Bytes."""
        return self.stop - self.start


class Pairs(NamedTuple):
    """Each item with each leaf of its region, in the order of the file.

    Attributes:
        item: Number of the item, int64 [P].
        leaf: The leaf, int64 [P].
        level: To which the item brings it, int64 [P].
        lower: What that takes off the leaf's error if it was one level coarser, [P]; 0 in level 0.
    """

    item: NDArray[np.int64]
    leaf: NDArray[np.int64]
    level: NDArray[np.int64]
    lower: NDArray[np.float64]


@dataclass(frozen=True)
class Catalog:
    """All items of a file, and the scene's regions.

    Attributes:
        items: By name, in the order of the file.
        errors: Mean squared error against the full model of an image of each level, [levels].
        awaits: Leaves that a missing page would divide further, by the page's name.
        table: The same where an image shows one leaf, [levels, R]; None if not measured.
        low: Leaves, the smallest regions that can differ in level: corner of their anchors' box,
            [R, 3].
        high: The opposite corner, world units [R, 3].
    """

    items: Mapping[Key, Item]
    errors: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    table: NDArray[np.float64] | None = None
    awaits: Mapping[Key, NDArray[np.int64]] = field(default_factory=dict[Key, NDArray[np.int64]])

    @cached_property
    def leaf_errors(self) -> NDArray[np.float64]:
        """Error of each leaf at each level, [levels, R]; a level's own where none was measured."""
        if self.table is not None:
            return self.table
        return np.broadcast_to(self.errors[:, None], (len(self.errors), self.leaves))

    @property
    def leaves(self) -> int:
        """R, number of leaves."""
        return len(self.low)

    @cached_property
    def parts(self) -> Parts:
        """Subdivided boxes of the leaves, to measure their visibility with."""
        return parts_of(self.low, self.high)

    @cached_property
    def rows(self) -> dict[Key, int]:
        """Number of each item."""
        return {key: row for row, key in enumerate(self.items)}

    @cached_property
    def sizes(self) -> NDArray[np.float64]:
        """Bytes of each item, [I]."""
        return np.array([item.size for item in self.items.values()], np.float64)

    @cached_property
    def parents(self) -> dict[Key, Key]:
        """The block, or coarser level, that each block refines."""
        return {
            key: next(need for need in item.needs if need.level < key.level)
            for key, item in self.items.items()
            if key.level and key.block >= 0
        }

    @cached_property
    def pairs(self) -> Pairs:
        """Who brings what where."""
        regions = [item.region for item in self.items.values()]
        row = np.repeat(np.arange(len(regions)), [len(region) for region in regions])
        leaf = np.concatenate([nowhere(), *regions])
        level = np.array([key.level for key in self.items], np.int64)[row]
        above = self.leaf_errors[np.maximum(level - 1, 0), leaf]
        return Pairs(row, leaf, level, np.maximum(above - self.leaf_errors[level, leaf], 0.0))

    @cached_property
    def brings(self) -> NDArray[np.float64]:
        """Error to which an item brings each leaf, infinite where it does not, [I, R]."""
        found = np.full((len(self.items), self.leaves), np.inf)
        row, leaf, level, _ = self.pairs
        found[row, leaf] = self.leaf_errors[level, leaf]
        return found

    def among(self, keys: Container[Key]) -> NDArray[np.bool_]:
        """Mask of the items with these keys, [I]."""
        return np.array([key in keys for key in self.items], np.bool_)

    def covered(self, share: NDArray[np.float64]) -> NDArray[np.float64]:
        """The share of an image that each item's region takes, [I], from those of leaves, [R]."""
        return _sums(self.pairs.item, share[self.pairs.leaf], len(self.items))

    def lowered(self, share: NDArray[np.float64]) -> NDArray[np.float64]:
        """Error that each item removes from an image if its parent is there, [I].

        Args:
            share: The leaves' shares of the image, [R].
        """
        row, leaf, _, lower = self.pairs
        return _sums(row, share[leaf] * lower, len(self.items))


def _sums(rows: NDArray[np.int64], values: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Sum of the values of each row, [count]."""
    return np.bincount(rows, values, count).astype(np.float64, copy=False)


def errors_of(psnr: Sequence[float | None]) -> NDArray[np.float64]:
    """Errors against the full model from each level's PSNR against photos.

    The finest level's own error is that of the photos; finer levels can remove only what a level
    has more. Levels without a figure are guessed, `STEP_DB` apart.
    """
    count = len(psnr)
    guess = [30.0 - STEP_DB * (count - 1 - k) for k in range(count)]
    if any(value is None for value in psnr):
        values = np.array(guess)
    else:
        stated = np.clip(np.array(psnr, np.float64), -DB_MAX, DB_MAX)
        values = np.maximum.accumulate(stated)
    mse = 10.0 ** (-values / 10.0)
    return np.maximum(mse - mse[-1], 10.0 ** (-FULL_DB / 10.0))


def catalog_of(
    assembler: Assembler, *, levels: int | None = None, by_blocks: bool = True
) -> Catalog:
    """The catalog of a file whose directories are known.

    Args:
        assembler: Holds index and the directories of these levels.
        levels: How many levels there are to fetch; None for all. A prefix of a file holds fewer
            than its tables list.
        by_blocks: False makes one item of each level.
    """
    count = levels or len(assembler.index.levels)
    leaves = leaves_of(assembler, count)
    items: dict[Key, Item] = {}
    shared: tuple[Key, ...] = ()
    for level in range(count):
        parts = _shared_parts(assembler, level)
        key, before = Key(level, SHARED), shared
        if level == 0 or not by_blocks:
            every, shared = np.arange(len(leaves.low)), (key,)
            items[key] = _whole_level(assembler, level, parts, before, every)
            continue
        # A level of splats whose codebook is that of the level before shares nothing of its own.
        if parts:
            items[key], shared = _item(key, parts, before, nowhere(), 0), (key,)
        items |= _blocks(assembler, level, leaves.lineage[level], shared)
    quality = assembler.quality[:count]
    errors = errors_of([figures.get("psnr_full") for figures in quality])
    table, awaits = None, dict[Key, NDArray[np.int64]]()
    if not assembler.index.paged:
        table = _table(assembler, leaves.lineage)
    elif by_blocks:
        awaits = _awaits(assembler, count, leaves)
    return Catalog(items, errors, leaves.low, leaves.high, table, awaits)


def page_key(level: int, page: int) -> Key:
    """Name of the item that is a page."""
    return Key(level, PAGES - page)


def block_parts(assembler: Assembler, level: int, blocks: Iterable[int]) -> list[Part]:
    """Blocks whose records are there."""
    directory = assembler.directories[level]
    return [Part(*directory.span_of(block), None, level, block) for block in blocks]


def _whole_level(
    assembler: Assembler,
    level: int,
    parts: list[Part],
    needs: tuple[Key, ...],
    region: NDArray[np.int64],
) -> Item:
    """All of a level as one item; in pages its blocks are found as it comes."""
    index = assembler.index
    entry = index.levels[level]
    slots = entry.live - (index.levels[level - 1].live if level else 0)
    if index.paged:
        parts += _page_parts(assembler, level)
    else:
        parts += block_parts(assembler, level, range(entry.blocks))
    key = Key(level, SHARED)
    return Item(key, parts[0].start, entry.end, needs, region, slots, tuple(parts))


def _page_parts(assembler: Assembler, level: int) -> list[Part]:
    table = assembler.pages[level]
    return [
        Part(*table.span_of(page), None, level, page_key(level, page).block)
        for page in range(len(table))
    ]


def _blocks(
    assembler: Assembler, level: int, lineage: NDArray[np.int64], shared: tuple[Key, ...]
) -> dict[Key, Item]:
    """Each block of a level whose record is there, and each page, in the order of the file."""
    directory = assembler.directories[level]
    grown = directory.records["live"].astype(np.int64) - directory.records["before"]
    parents = directory.records["parent"].tolist()
    regions = grouped(lineage, len(directory))
    found: list[Item] = []
    for part in block_parts(assembler, level, known_blocks(assembler, level).tolist()):
        parent = Key(level - 1, parents[part.block] if level > 1 else SHARED)
        name, slots = Key(level, part.block), int(grown[part.block])
        found.append(_item(name, [part], (parent, *shared), regions[part.block], slots))
    for part in _page_parts(assembler, level) if assembler.index.paged else ():
        upper = int(assembler.pages[level].records["parent"][PAGES - part.block])
        needs = page_key(level - 1, upper) if level > 1 else Key(0, SHARED)
        found.append(_item(Key(level, part.block), [part], (needs,), nowhere(), 0))
    # Of blocks without bytes that begin where a page does, those of its own stand behind it.
    found.sort(key=lambda item: (item.start, item.stop > item.start and item.key.block >= 0))
    return {item.key: item for item in found}


def _awaits(assembler: Assembler, levels: int, leaves: Leaves) -> dict[Key, NDArray[np.int64]]:
    """Leaves of pages that are not there but whose place in the level before is known."""
    found: dict[Key, NDArray[np.int64]] = {}
    for level in range(1, levels):
        table, above = assembler.pages[level], leaves.lineage[level - 1]
        open_leaves = np.flatnonzero((above != UNKNOWN) & (leaves.lineage[level] == UNKNOWN))
        page = np.searchsorted(table.parents, above[open_leaves], side="right") - 1
        for number, own in enumerate(grouped(page, len(table))):
            if len(own):
                found[page_key(level, number)] = open_leaves[own]
    return found


def _table(
    assembler: Assembler, lineage: Sequence[NDArray[np.int64]]
) -> NDArray[np.float64] | None:
    """Errors of leaves from the utilities of their blocks, if the file carries them."""
    blocks = [level.blocks for level in assembler.index.levels[1:]]
    utilities = parse_utility(assembler.meta.get(UTILITY_NOTE, ""), blocks)
    if utilities is None:
        return None
    table = np.full((len(lineage), len(lineage[-1])), 10.0 ** (-FULL_DB / 10.0))
    for level in range(len(lineage) - 1, 0, -1):
        table[level - 1] = table[level] + utilities[level - 1][lineage[level]]
    return table


def _shared_parts(assembler: Assembler, level: int) -> list[Part]:
    return [
        Part(chunk.offset, chunk.offset + chunk.stored, chunk, level, SHARED)
        for chunk in assembler.index.chunks
        if chunk.level == level and chunk.kind not in {Kind.MANIFEST, Kind.DIRECTORY, Kind.BLOCKS}
    ]


def _item(
    key: Key, parts: list[Part], needs: tuple[Key, ...], region: NDArray[np.int64], slots: int
) -> Item:
    return Item(key, parts[0].start, parts[-1].stop, needs, region, slots, tuple(parts))
