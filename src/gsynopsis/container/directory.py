"""The directory of a level: its spatial blocks, where they lie and which anchors they hold.

Blocks divide the anchors of a level into pieces that can be fetched alone. Those of level k divide
each block of level k − 1 further, so what a client holds is a level for every region.
"""

import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gsynopsis.container import layout
from gsynopsis.container.blocks import block_bytes
from gsynopsis.container.codecs import Array, Bytes, CodecError, inflate
from gsynopsis.container.index import Index, name_of
from gsynopsis.container.layout import BlockEntry, ChunkEntry, Kind
from gsynopsis.errors import ChecksumError, LayoutError, TruncatedError, ValueRangeError

Int64 = NDArray[np.int64]


def record_type(level: int, entry: layout.Record = BlockEntry) -> np.dtype[np.void]:
    """A directory's, or page table's, record at a level as NumPy type."""
    codes = {"I": "<u4", "i": "<i4", "f": "<f4", "Q": "<u8"}
    fields = [(n, codes[f.code]) for n, f in layout.fields_of(entry).items()]
    return np.dtype([*fields, ("rows", "<u4", (level + 1,))])


@dataclass(frozen=True)
class Directory:
    """The blocks of one level.

    Attributes:
        level: Which.
        records: One `BlockEntry` with its rows per level for each block, in file order.
        offsets: File offset of each block, int64 [B].
        starts: First row of each block among the anchors new at each level up to this one, as
            numbers of anchors in the whole file, int64 [B, level + 1].
    """

    level: int
    records: Array
    offsets: Int64
    starts: Int64

    def __len__(self) -> int:
        return len(self.records)

    def rows_of(self, block: int) -> NDArray[np.int64]:
        """Numbers of a block's anchors, those of coarser levels first, int64 [rows]."""
        return ranges(self.starts[block], self.records["rows"][block])

    def span_of(self, block: int) -> tuple[int, int]:
        """First and last byte + 1 of a block in the file."""
        start = int(self.offsets[block])
        return start, start + int(self.records["stored"][block])

    def fresh_of(self, block: int) -> tuple[int, int]:
        """First row and row after the last of the anchors that are new in a block."""
        start = int(self.starts[block, -1])
        return start, start + int(self.records["rows"][block, -1])


def ranges(starts: Array, counts: Array) -> Int64:
    """The numbers start … start + count − 1 of each pair, one after the other, int64."""
    pieces = [np.arange(int(a), int(a) + int(n)) for a, n in zip(starts, counts, strict=True)]
    return np.concatenate(pieces).astype(np.int64, copy=False)


def pack_directory(records: Array) -> bytes:
    """The raw bytes of a directory: records field by field in byte planes."""
    fields = np.frombuffer(records.tobytes(), np.uint8).reshape(len(records), -1)
    return np.ascontiguousarray(fields.T).tobytes()


def parse_directory(
    index: Index, level: int, stored: Bytes, source: str, parent: Directory | None
) -> Directory:
    """A directory from its chunk's bytes, everything checked.

    Args:
        index: Of the file.
        level: Whose directory.
        stored: The chunk's bytes.
        source: What messages call the file.
        parent: Directory of the level before, None for level 0.

    Raises:
        FormatError: it breaks a promise of docs/format.md.
    """
    chunk = index.chunk_of(level, Kind.DIRECTORY)
    where = name_of(chunk)
    raw = checked_bytes(chunk, stored, where, source)
    records = unpack_records(raw, record_type(level))
    check_records(index, level, records, source)
    blocks = index.chunk_of(level, Kind.BLOCKS)
    directory = make_directory(level, records, blocks.offset, first_rows(index, level))
    if parent is not None:
        check_parents(records, parent.records, where, source)
    return directory


def unpack_records(raw: Bytes, kind: np.dtype[np.void]) -> Array:
    """Records from their byte planes; see `pack_directory`."""
    planes = np.frombuffer(raw, np.uint8).reshape(kind.itemsize, -1)
    return np.ascontiguousarray(planes.T).view(kind)[:, 0]


def first_rows(index: Index, level: int) -> Int64:
    """Number of the first anchor that is new at each level up to one, int64 [level + 1]."""
    return np.array([index.anchors_before(k) for k in range(level + 1)], np.int64)


def make_directory(level: int, records: Array, offset: int, firsts: Int64) -> Directory:
    """A directory from its records; the first block lies at `offset` and begins with `firsts`."""
    stored = records["stored"].astype(np.int64)
    rows = records["rows"].astype(np.int64)
    starts = firsts + np.cumsum(rows, axis=0) - rows
    return Directory(level, records, offset + np.cumsum(stored) - stored, starts)


def checked_bytes(chunk: ChunkEntry, stored: Bytes, where: str, source: str) -> Bytes:
    """Inflated bytes of a chunk whose length and checksum are right.

    Raises:
        TruncatedError: the length is not the table's.
        ChecksumError: the checksum is not.
        LayoutError: they do not inflate to what the table says.
    """
    return checked_span(stored, (chunk.stored, chunk.raw, chunk.crc), where, source)


def checked_span(stored: Bytes, sizes: tuple[int, int, int], where: str, source: str) -> Bytes:
    """As `checked_bytes`, with stored length, raw length and checksum given."""
    length, raw, checksum = sizes
    if len(stored) != length:
        found = f"{len(stored)} bytes"
        raise TruncatedError(source, where, found=found, expected=f"{length}")
    crc = zlib.crc32(stored)
    if crc != checksum:
        found, expected = f"CRC-32 {crc:08x}", f"{checksum:08x}"
        advice = "the bytes were changed; fetch the file again"
        raise ChecksumError(source, where, found=found, expected=expected, advice=advice)
    try:
        return inflate(stored, raw)
    except CodecError as error:
        raise LayoutError(source, where, found=error) from error


def check_records(index: Index, level: int, records: Array, source: str) -> None:
    """Ranges and sums of a directory fit the tables of the index."""
    where = name_of(index.chunk_of(level, Kind.DIRECTORY))
    check_fields(records, BlockEntry, f"{where}: block", source)
    blocks = index.chunk_of(level, Kind.BLOCKS)
    sums = {"stored": blocks.stored, "raw": blocks.raw, **level_sums(index, level)}
    check_sums(records, sums, where, source)
    check_blocks(index, level, records, where, source)


def check_fields(records: Array, entry: layout.Record, where: str, source: str) -> None:
    """Every field lies in the range that layout.py gives it."""
    for name, field in layout.fields_of(entry).items():
        values = records[name]
        if field.code == "f":
            good = np.isfinite(values) & (values >= field.low)
            error, expected = ValueRangeError, "finite and ≥ 0"
        else:
            wide = values.astype(np.int64)
            good, error = (wide >= field.low) & (wide <= field.high), LayoutError
            expected = f"{field.low:.0f} to {field.high:.0f}"
        if not good.all():
            number = int(np.argmin(good))
            raise error(
                source, f"{where} {number}: {name}", found=values[number], expected=expected
            )


def level_sums(index: Index, level: int) -> dict[str, int | list[int]]:
    """Sums over the records of a level, by name: live slots and rows."""
    before = index.levels[level - 1].live if level else 0
    rows = [index.levels[k].anchors - index.anchors_before(k) for k in range(level + 1)]
    return {"live": index.levels[level].live, "before": before, "rows": rows}


def check_sums(records: Array, sums: dict[str, int | list[int]], where: str, source: str) -> None:
    """Check that fields of all records sum up to the known totals."""
    for name, expected in sums.items():
        # Sums of 64-bit fields may fit no number of NumPy's.
        wide = np.int64 if records.dtype[name].base.itemsize < 8 else object
        found = records[name].sum(axis=0, dtype=wide)
        found = [int(n) for n in found] if isinstance(expected, list) else int(found)
        if found != expected:
            raise LayoutError(source, f"{where}: {name}", found=found, expected=expected)


def check_blocks(index: Index, level: int, records: Array, where: str, source: str) -> None:
    """Each block's own counts fit each other and its raw length."""
    rows = records["rows"].astype(np.int64)
    total, fresh = rows.sum(axis=1), rows[:, -1]
    live, before = records["live"].astype(np.int64), records["before"].astype(np.int64)
    slots = index.header.slots
    sizes = block_bytes(index, level, records)
    stored, raw = records["stored"].astype(np.int64), records["raw"].astype(np.int64)
    rules = {
        "rows": (total <= layout.BLOCK_ROWS_MAX, f"at most {layout.BLOCK_ROWS_MAX} anchors"),
        "live": ((live >= before + fresh) & (live <= total * slots), "as its anchors can have"),
        "before": ((before >= total - fresh) & (before <= (total - fresh) * slots), "as above"),
        "raw": (raw == sizes, "what its counts and codings give"),
        "stored": ((stored <= raw) & ((stored > 0) | (raw == 0)), "1 to raw, 0 if raw is"),
    }
    if not level:
        rules["parent"] = (records["parent"] == 0, "0 at level 0")
    check_rules(records, rules, f"{where}: block", source)


Rules = dict[str, tuple[NDArray[np.bool_], str]]
"""By field: for each record whether it is good, and what was expected."""


def check_rules(records: Array, rules: Rules, where: str, source: str) -> None:
    """All records keep all rules, and boxes have no corner on the wrong side."""
    for axis in "xyz":
        good = records[f"low_{axis}"] <= records[f"high_{axis}"]
        rules[f"low_{axis}"] = (good, f"at most high_{axis}")
    for name, (good, expected) in rules.items():
        if not good.all():
            number = int(np.argmin(good))
            found = records[name][number]
            raise LayoutError(source, f"{where} {number}: {name}", found=found, expected=expected)


def check_parents(records: Array, parents: Array, where: str, source: str, first: int = 0) -> None:
    """Blocks, or pages, divide their parents: in order, none without a child, counts add up.

    Args:
        records: Of the children.
        parents: Of all their parents.
        where: Names the children in messages.
        source: What messages call the file.
        first: Number of the first parent.
    """
    link = records["parent"].astype(np.int64)
    steps, last = np.diff(link), first + len(parents) - 1
    if link[0] != first or link[-1] != last or ((steps != 0) & (steps != 1)).any():
        expected = f"{first} to {last} in order, each at least once"
        raise LayoutError(source, f"{where}: parent", found="others", expected=expected)
    heads = np.flatnonzero(np.diff(link, prepend=-1))
    for name, child, own in (
        ("rows", records["rows"][:, :-1], parents["rows"]),
        ("before", records["before"], parents["live"]),
    ):
        sums = np.add.reduceat(child.astype(np.int64), heads, axis=0)
        if (sums != own).any():
            expected = "the sums of the level before"
            raise LayoutError(source, f"{where}: {name}", found="others", expected=expected)
