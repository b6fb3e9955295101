"""Every offset, field name and number of a .gsyn file; docs/format.md is printed from here.

`python -m gsynopsis.pack.layout` prints the tables that docs/format.md holds between its marks.
A record is a NamedTuple whose annotations carry type, meaning and range of each field, in file
order, little-endian and without padding.
"""

import math
import struct
from enum import IntEnum
from functools import cache
from typing import Annotated, NamedTuple, get_args, get_type_hints

MAGIC = b"GSYN\r\n\x1a\n"
VERSION = 1
KNOWN_FEATURES = 0
"""Bits of `required` that this reader understands; version 1 defines none."""

INDEX_BYTES_MAX = 16384
"""Header, level table and chunk table together, bytes."""
MANIFEST_BYTES_MAX = 65536
EXPANSION_MAX = 64
"""Decoded values may claim this many bytes (or slots) per byte of file, plus a base."""
RAW_BYTES_BASE = 1 << 26
SLOTS_BASE = 1 << 22

_TINY = math.ulp(0.0)
_ANY = -math.inf
_U32 = (1 << 32) - 1
_POINTERS = 1 << 53
"""Offsets and lengths stay exact in a JavaScript number."""


class Kind(IntEnum):
    """What a chunk holds; the numbers are the file's."""

    MANIFEST = 1
    NETWORKS = 2
    CODEBOOK = 3
    GRID = 4
    LATTICE = 5
    LOG_SCALES = 6
    CODES = 7
    RESIDUAL = 8
    MASK = 9
    OFFSETS = 10

    @property
    def label(self) -> str:
        """The name used in messages, reports and the documentation."""
        return self.name.lower()


class CodingId(IntEnum):
    """How a chunk's values became bytes; `codecs.CODINGS` has the functions."""

    PLAIN = 0
    SHUFFLE = 1
    HALF = 2
    DELTA = 3
    MORTON = 4

    @property
    def label(self) -> str:
        """The name used in messages, reports and the documentation."""
        return self.name.lower()


class Field(NamedTuple):
    """One field of a record: a struct code, what it means and its range, both ends included."""

    code: str
    meaning: str
    low: float = _ANY
    high: float = math.inf


class Header(NamedTuple):
    """The fixed first bytes of a file: what it takes to read the tables, and the frame."""

    magic: Annotated[bytes, Field("8s", "`GSYN`, CR, LF, 0x1A, LF")]
    version: Annotated[int, Field("I", "version of the format", VERSION, VERSION)]
    required: Annotated[int, Field("I", "bits of features a reader must know", 0, KNOWN_FEATURES)]
    levels: Annotated[int, Field("H", "records in the level table", 1, 16)]
    chunks: Annotated[int, Field("H", "records in the chunk table", 2, 320)]
    slots: Annotated[int, Field("H", "K, slots per anchor", 1, 256)]
    features: Annotated[int, Field("H", "F, values per grid entry, 0 without grids", 0, 256)]
    residual: Annotated[int, Field("H", "R, residual values per anchor", 0, 1024)]
    contract: Annotated[int, Field("H", "1: space is contracted, 0: it is a box", 0, 1)]
    crc: Annotated[int, Field("I", "CRC-32 of header and tables, this field taken as 0")]
    voxel: Annotated[float, Field("d", "edge of a lattice cell, world units", _TINY)]
    center_x: Annotated[float, Field("d", "centre of the frame, world units")]
    center_y: Annotated[float, Field("d", "as above")]
    center_z: Annotated[float, Field("d", "as above")]
    radius: Annotated[float, Field("d", "radius of the frame, world units", _TINY)]
    extent: Annotated[float, Field("d", "unit of viewing distance, world units", _TINY)]


class LevelEntry(NamedTuple):
    """One level: where it ends in the file, what it counts and the sizes of its networks."""

    end: Annotated[int, Field("Q", "file offset where this level ends", 1, _POINTERS)]
    anchors: Annotated[int, Field("I", "n, anchors present at this level", 0, (1 << 31) - 1)]
    live: Annotated[int, Field("I", "live slots of this level", 0, _U32)]
    grids: Annotated[int, Field("H", "grids read by this level", 0, 64)]
    head_hidden: Annotated[int, Field("H", "hidden width of each head", 1, 4096)]
    fuse_hidden: Annotated[
        int, Field("H", "hidden width of the fusion MLP, 0: there is none", 0, 4096)
    ]
    fuse_out: Annotated[
        int, Field("H", "output width of the fusion MLP, 0: there is none", 0, 4096)
    ]
    codebook_rows: Annotated[int, Field("H", "C, entries of the codebook", 0, 256)]
    codebook_columns: Annotated[int, Field("H", "D, values per entry", 0, 1024)]
    gain_x: Annotated[float, Field("f", "factor on the first scale of Gaussians", _TINY)]
    gain_y: Annotated[float, Field("f", "on the second", _TINY)]
    gain_z: Annotated[float, Field("f", "on the third", _TINY)]


class ChunkEntry(NamedTuple):
    """One chunk: what it is, where its bytes lie and how they become a [rows, columns] array."""

    kind: Annotated[int, Field("B", "what it holds, see the table of kinds", 1, max(Kind))]
    level: Annotated[int, Field("B", "level that first needs it", 0, 15)]
    coding: Annotated[int, Field("B", "see the table of codings", 0, max(CodingId))]
    reserved: Annotated[int, Field("B", "0", 0, 0)]
    part: Annotated[int, Field("I", "number of the grid; 0 for other kinds", 0, 63)]
    offset: Annotated[int, Field("Q", "file offset of the first byte", 0, _POINTERS)]
    stored: Annotated[int, Field("Q", "bytes in the file", 1, _POINTERS)]
    raw: Annotated[int, Field("Q", "bytes after inflating, `stored` if not deflated", 1, _POINTERS)]
    rows: Annotated[int, Field("I", "rows of the array", 1, _U32)]
    columns: Annotated[int, Field("I", "values per row", 1, (1 << 31) - 1)]
    crc: Annotated[int, Field("I", "CRC-32 of the stored bytes")]
    resolution: Annotated[int, Field("I", "grid: vertices per axis; 0 for other kinds", 0, 1 << 20)]


Record = type[Header] | type[LevelEntry] | type[ChunkEntry]


@cache
def fields_of(record: Record) -> dict[str, Field]:
    """Name and field of each entry of a record, in file order."""
    hints = get_type_hints(record, include_extras=True)
    return {name: get_args(hints[name])[1] for name in record._fields}


def _struct_of(record: Record) -> struct.Struct:
    return struct.Struct("<" + "".join(f.code for f in fields_of(record).values()))


HEADER = _struct_of(Header)
LEVEL = _struct_of(LevelEntry)
CHUNK = _struct_of(ChunkEntry)


def offsets_of(record: Record) -> dict[str, int]:
    """Name and byte offset of each field within its record."""
    offsets: dict[str, int] = {}
    position = 0
    for name, field in fields_of(record).items():
        offsets[name] = position
        position += struct.calcsize("<" + field.code)
    return offsets


def index_bytes(levels: int, chunks: int) -> int:
    """Length of header and both tables."""
    return HEADER.size + levels * LEVEL.size + chunks * CHUNK.size


class KindRule(NamedTuple):
    """What the array of a kind is: its NumPy type, the meaning of rows and columns."""

    dtype: str
    rows: str
    columns: str
    meaning: str


KINDS = {
    Kind.MANIFEST: KindRule("u1", "bytes", "1", "UTF-8 JSON, see below"),
    Kind.NETWORKS: KindRule(
        "f4", "all weights", "1", "every matrix and bias of the level, in order"
    ),
    Kind.CODEBOOK: KindRule("f4", "C", "D", "the codebook of the level"),
    Kind.GRID: KindRule("f4", "T", "F", "one grid, `part` counts from 0, coarse to fine"),
    Kind.LATTICE: KindRule("i4", "new anchors", "3", "lattice coordinates x, y, z"),
    Kind.LOG_SCALES: KindRule("f4", "new anchors", "6", "natural logarithms of base scales"),
    Kind.CODES: KindRule("u1", "new anchors", "1", "codebook entry of each anchor"),
    Kind.RESIDUAL: KindRule("f4", "new anchors", "R", "continuous features of each anchor"),
    Kind.MASK: KindRule("u1", "ceil(bits / 8)", "1", "live bits of slots that were off before"),
    Kind.OFFSETS: KindRule("f4", "new live slots", "3", "offsets of slots that became live"),
}

CODING_MEANINGS = {
    CodingId.PLAIN: "values as they are; not deflated",
    CodingId.SHUFFLE: "values as they are, byte-shuffled, deflated",
    CodingId.HALF: "float32 rounded to float16, byte-shuffled, deflated",
    CodingId.DELTA: "int32 columns as zigzag differences, byte-shuffled, deflated",
    CodingId.MORTON: "int32 base of 3, then differences of Morton codes, byte-shuffled, deflated",
}

_TYPE_NAMES = {"B": "u8", "H": "u16", "I": "u32", "Q": "u64", "f": "f32", "d": "f64", "8s": "8 B"}


def _range_text(field: Field) -> str:
    if field.code in "fd":
        return "> 0" if field.low > 0 else "finite"
    if field.low == _ANY:
        return ""
    if field.low == field.high:
        return f"{field.low}"
    high = int(field.high)
    power = high.bit_length() - 1
    names = {1 << power: f"2^{power}", (2 << power) - 1: f"2^{power + 1} − 1"}
    return f"{field.low}…{names.get(high, high) if power > 15 else high}"


def _record_table(title: str, record: Record, size: int) -> list[str]:
    lines = [f"**{title}, {size} bytes**", "", "| offset | type | field | range | meaning |"]
    lines.append("|---|---|---|---|---|")
    offsets = offsets_of(record)
    for name, field in fields_of(record).items():
        kind, span = _TYPE_NAMES[field.code], _range_text(field)
        lines.append(f"| {offsets[name]} | {kind} | `{name}` | {span} | {field.meaning} |")
    return [*lines, ""]


def tables() -> str:
    """The tables of docs/format.md as Markdown."""
    lines = _record_table("Header", Header, HEADER.size)
    lines += _record_table("Record of the level table", LevelEntry, LEVEL.size)
    lines += _record_table("Record of the chunk table", ChunkEntry, CHUNK.size)
    lines += ["**Kinds of chunks**", "", "| kind | name | type | rows | columns | meaning |"]
    lines.append("|---|---|---|---|---|---|")
    names = {"u1": "u8", "i4": "i32", "f4": "f32"}
    for kind, rule in KINDS.items():
        row = f"| {kind:d} | `{kind.label}` | {names[rule.dtype]} | {rule.rows} | {rule.columns} "
        lines.append(row + f"| {rule.meaning} |")
    lines += ["", "**Codings**", "", "| coding | name | bytes |", "|---|---|---|"]
    lines += [f"| {c:d} | `{c.label}` | {text} |" for c, text in CODING_MEANINGS.items()]
    return "\n".join(lines)


if __name__ == "__main__":
    print(tables())
