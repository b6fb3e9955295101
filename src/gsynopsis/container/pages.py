"""Directories in pages: a file of very many blocks has them in place of whole ones.

A page is a run of records of a directory; it stands before its blocks. The page table of a level
says of each page what a directory says of a block, so where its blocks lie, which anchors they hold
and which blocks they divide follows from the table, and a page is of use without the others.
"""

import itertools
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gsynopsis.container import layout
from gsynopsis.container.codecs import Array, Bytes, deflate
from gsynopsis.container.directory import (
    Directory,
    Int64,
    check_blocks,
    check_fields,
    check_parents,
    check_rules,
    check_sums,
    checked_bytes,
    checked_span,
    first_rows,
    level_sums,
    make_directory,
    pack_directory,
    record_type,
    unpack_records,
)
from gsynopsis.container.encode_level import LevelPieces
from gsynopsis.container.index import Index, name_of
from gsynopsis.container.layout import BlockEntry, Kind, PageEntry
from gsynopsis.errors import LayoutError, ValueRangeError

PAGE_BLOCKS = 256
"""Blocks of a page as a writer makes them: some 8 KB, as much as a small block (ours)."""
WHOLE_PAGES = 4
"""Directories with at most the blocks of this many pages stay whole."""


@dataclass(frozen=True)
class PageTable:
    """The pages of one level's directory.

    Attributes:
        level: Which.
        records: One `PageEntry` with its rows per level for each page, in file order.
        offsets: File offset of each page's own bytes, int64 [P]; its blocks follow them.
        starts: As in `Directory`, of the first block of each page, int64 [P, level + 1].
        first: Number of each page's first block, and of all blocks, int64 [P + 1].
        parents: Number of the first block that its blocks divide, and of all, int64 [P + 1].
    """

    level: int
    records: Array
    offsets: Int64
    starts: Int64
    first: Int64
    parents: Int64

    def __len__(self) -> int:
        return len(self.records)

    def page_of(self, block: int) -> int:
        """The page that has the record of a block."""
        return int(np.searchsorted(self.first, block, side="right")) - 1

    def blocks_of(self, page: int) -> range:
        """Numbers of the blocks of a page."""
        return range(int(self.first[page]), int(self.first[page + 1]))

    def parents_of(self, page: int) -> range:
        """Numbers of the blocks of the level before that these divide."""
        return range(int(self.parents[page]), int(self.parents[page + 1]))

    def span_of(self, page: int) -> tuple[int, int]:
        """First and last byte + 1 of a page in the file."""
        start = int(self.offsets[page])
        return start, start + int(self.records["stored"][page])


def parse_pages(
    index: Index, level: int, stored: Bytes, source: str, parent: PageTable | None
) -> PageTable:
    """The page table of a level from its chunk's bytes, everything checked.

    Args:
        index: Of the file.
        level: Whose directory.
        stored: The chunk's bytes.
        source: What messages call the file.
        parent: That of the level before, None for level 0.

    Raises:
        FormatError: it breaks a promise of docs/format.md.
    """
    chunk = index.chunk_of(level, Kind.DIRECTORY)
    where = name_of(chunk)
    raw = checked_bytes(chunk, stored, where, source)
    records = unpack_records(raw, record_type(level, PageEntry))
    check_fields(records, PageEntry, f"{where}: page", source)
    counts = {name: records[name].astype(np.int64) for name in ("stored", "blocks", "parents")}
    parents = index.levels[level - 1].blocks if level else 0
    sums = {"blocks": index.levels[level].blocks, "parents": parents, **level_sums(index, level)}
    check_sums(records, sums, where, source)
    _check_pages(index, level, records, where, source)
    if parent is not None:
        check_parents(records, parent.records, where, source)
        heads = np.flatnonzero(np.diff(records["parent"].astype(np.int64), prepend=-1))
        if (np.add.reduceat(counts["parents"], heads) != parent.records["blocks"]).any():
            expected = "the blocks of the level before"
            raise LayoutError(source, f"{where}: parents", found="others", expected=expected)
    lengths = counts["stored"] + records["body"].astype(np.int64)
    rows = records["rows"].astype(np.int64)
    return PageTable(
        level=level,
        records=records,
        offsets=index.chunk_of(level, Kind.BLOCKS).offset + np.cumsum(lengths) - lengths,
        starts=first_rows(index, level) + np.cumsum(rows, axis=0) - rows,
        first=np.concatenate([[0], np.cumsum(counts["blocks"])]),
        parents=np.concatenate([[0], np.cumsum(counts["parents"])]),
    )


def _check_pages(index: Index, level: int, records: Array, where: str, source: str) -> None:
    """Each page's own counts fit each other, and all pages fill the level's bytes."""
    blocks = index.chunk_of(level, Kind.BLOCKS)
    size = layout.block_entry_bytes(level)
    stored = int(records["stored"].sum(dtype=np.int64))
    check_sums(records, {"body": blocks.stored - stored}, where, source)
    check_sums(records, {"raw": blocks.raw - size * index.levels[level].blocks}, where, source)
    rows = records["rows"].astype(np.int64)
    total, fresh = rows.sum(axis=1), rows[:, -1]
    live, before = records["live"].astype(np.int64), records["before"].astype(np.int64)
    slots, count = index.header.slots, records["blocks"].astype(np.int64)
    parents, least = records["parents"].astype(np.int64), int(level > 0)
    rules = {
        "stored": (records["stored"] <= count * size, "at most its records' bytes"),
        "parent": ((records["parent"] == 0) | (level > 0), "0 at level 0"),
        "parents": ((parents >= least) & (parents <= count * least), "1 to blocks, 0 at level 0"),
        "live": ((live >= before + fresh) & (live <= total * slots), "as its anchors can have"),
        "before": ((before >= total - fresh) & (before <= (total - fresh) * slots), "as above"),
        "body": (records["body"] <= records["raw"], "at most raw"),
    }
    check_rules(records, rules, f"{where}: page", source)


def parse_page(
    index: Index, table: PageTable, page: int, stored: Bytes, source: str, parents: Array | None
) -> Directory:
    """The part of a directory that is in a page, everything checked.

    Args:
        index: Of the file.
        table: Of its level.
        page: Which.
        stored: Its bytes.
        source: What messages call the file.
        parents: Records of `table.parents_of(page)`; None at level 0.

    Raises:
        FormatError: it breaks a promise of docs/format.md.
    """
    level, record = table.level, table.records[page]
    where = f"level {level} page {page}"
    count, kind = int(record["blocks"]), record_type(level)
    sizes = (int(record["stored"]), count * kind.itemsize, int(record["crc"]))
    records = unpack_records(checked_span(stored, sizes, where, source), kind)
    check_fields(records, BlockEntry, f"{where}: block", source)
    sums = {"stored": int(record["body"]), "raw": int(record["raw"])}
    rows = [int(n) for n in record["rows"]]
    own = {"live": int(record["live"]), "before": int(record["before"]), "rows": rows}
    check_sums(records, {**sums, **own}, where, source)
    check_blocks(index, level, records, where, source)
    _check_box(records, record, where, source)
    if parents is not None:
        check_parents(records, parents, where, source, int(table.parents[page]))
    return make_directory(level, records, table.span_of(page)[1], table.starts[page])


def _check_box(records: Array, record: np.void, where: str, source: str) -> None:
    """The page's box and reach have in them those of its blocks that have anchors."""
    some = records["rows"].any(axis=1)
    inside = records["reach"] <= record["reach"]
    for axis in "xyz":
        inside &= records[f"low_{axis}"] >= record[f"low_{axis}"]
        inside &= records[f"high_{axis}"] <= record[f"high_{axis}"]
    if not (inside | ~some).all():
        number = int(np.argmin(inside | ~some))
        expected = "a box and a reach within its page's"
        raise ValueRangeError(source, f"{where}: block {number}", found="others", expected=expected)


def unknown_blocks(index: Index, level: int) -> Directory:
    """A directory without any of its pages: all records are 0."""
    count = index.levels[level].blocks
    records = np.zeros(count, record_type(level))
    starts = np.zeros((count, level + 1), np.int64)
    return Directory(level, records, np.zeros(count, np.int64), starts)


def put_page(whole: Directory, page: Directory, first: int) -> None:
    """Put a page, whose first block has that number, into the directory of its level."""
    place = slice(first, first + len(page))
    whole.records[place], whole.offsets[place] = page.records, page.offsets
    whole.starts[place] = page.starts


@dataclass(frozen=True)
class LevelPages:
    """The pages of a level as a writer has them: records of the table [P], bytes of each."""

    records: Array
    bodies: tuple[bytes, ...]
    first: tuple[int, ...]

    def interleave(self, blocks: Sequence[bytes]) -> bytes:
        """Each page before its blocks."""
        spans = zip(self.bodies, itertools.pairwise(self.first), strict=True)
        return b"".join(itertools.chain.from_iterable((p, *blocks[a:b]) for p, (a, b) in spans))


def in_pages(levels: Sequence[LevelPieces], size: int) -> bool:
    """True if the directories of a file with these blocks are cut into pages of `size` blocks."""
    return any(len(level.records) > WHOLE_PAGES * size for level in levels)


def cut_pages(levels: Sequence[LevelPieces], size: int) -> list[LevelPages]:
    """The pages of every level, each of at most `size` blocks as far as blocks' children allow."""
    found: list[LevelPages] = []
    for number, pieces in enumerate(levels):
        records = pieces.records
        if not number:
            ends = [*range(size, len(records), size), len(records)]
            link, counts = [0] * len(ends), [0] * len(ends)
        else:
            ends, link, counts = _families(records["parent"], found[-1].first, size)
        first = [0, *ends]
        bodies = [deflate(pack_directory(records[a:b]))[0] for a, b in itertools.pairwise(first)]
        table = _summed(records, first, number)
        table["parent"], table["parents"] = link, counts
        table["stored"] = [len(body) for body in bodies]
        table["crc"] = [zlib.crc32(body) for body in bodies]
        found.append(LevelPages(table, tuple(bodies), tuple(first)))
    return found


def _families(
    link: Array, pages: Sequence[int], size: int
) -> tuple[list[int], list[int], list[int]]:
    """Ends of pages that divide those of the level before and part no block's children.

    Returns:
        Ends, the page of the level before of each, and how many of its blocks they divide.
    """
    ends: list[int] = []
    parents: list[int] = []
    counts: list[int] = []
    for page, (a, b) in enumerate(itertools.pairwise(pages)):
        edges = np.searchsorted(link, np.arange(a, b + 1)).tolist()
        start = 0
        for number in range(1, len(edges)):
            last = number == len(edges) - 1
            if last or edges[number + 1] - edges[start] > size:
                ends.append(edges[number])
                parents.append(page)
                counts.append(number - start)
                start = number
    return ends, parents, counts


def _summed(records: Array, first: Sequence[int], level: int) -> Array:
    """Records of a page table with all that follows from those of the blocks."""
    heads = np.array(first[:-1])
    table = np.zeros(len(heads), record_type(level, PageEntry))
    table["blocks"] = np.diff(first)
    for name, own in (
        ("live", "live"), ("before", "before"), ("rows", "rows"), ("body", "stored"), ("raw", "raw")
    ):  # fmt: skip
        table[name] = np.add.reduceat(records[own].astype(np.int64), heads, axis=0)
    table["reach"] = np.maximum.reduceat(records["reach"], heads)
    some = np.add.reduceat(records["rows"].any(axis=1).astype(np.int64), heads) > 0
    empty = ~records["rows"].any(axis=1)
    for axis in "xyz":
        for end, least, of in (("low", 2**31 - 1, np.minimum), ("high", -(2**31), np.maximum)):
            corner = np.where(empty, least, records[f"{end}_{axis}"])
            table[f"{end}_{axis}"] = np.where(some, of.reduceat(corner, heads), 0)
    return table
