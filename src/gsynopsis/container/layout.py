"""Every offset, field name and number of a .gsyn file: the one place with offsets.

`scripts/layout` writes the tables of docs/format.md and viewer/src/format/layout.gen.ts from here.
A record is a NamedTuple whose annotations carry type, meaning and range of each field, in file
order, little-endian and without padding.
"""

import math
import struct
from enum import IntEnum
from functools import cache
from typing import Annotated, NamedTuple, get_args, get_type_hints

from gsynopsis import records

MAGIC = b"GSYN\r\n\x1a\n"
VERSION = 1
TIED_WEIGHTS = 1
"""Bit of `required`: the networks of some level have the matrices of the level before."""
SPLATS = 2
"""Bit of `required`: rows are splats, Gaussians with values of their own, not anchors."""
PAGES = 4
"""Bit of `required`: the directory of each level is in pages, which its blocks stand among."""
STAND_INS = 8
"""Bit of `required`: the splats of some coarse levels are dropped by finer ones."""
KNOWN_FEATURES = TIED_WEIGHTS | SPLATS | PAGES | STAND_INS
"""Bits of `required` that this reader understands."""

INDEX_BYTES_MAX = 16384
"""Header, level table and chunk table together, bytes."""
MANIFEST_BYTES_MAX = 65536
POSTER_BYTES_MAX = 4096
POSTER_PIXELS_MAX = 64
"""Most pixels of either side of the poster."""
BLOCKS_MAX = 65536
"""Blocks of one level."""
BLOCK_ROWS_MAX = 65536
"""Anchors of one block."""
BLOCK_RAW_MAX = 1 << 27
"""Inflated bytes of one block."""
EXPANSION_MAX = 64
"""Decoded values may claim this many bytes (or slots) per byte of file, plus a base."""
RAW_BYTES_BASE = 1 << 25
SLOTS_BASE = 1 << 20
VALUES_BASE = 1 << 24
VALUES_EXPANSION_MAX = 1024
"""Features, hidden values and outputs of all anchors of a level may number this many per byte of
file, plus the base: a renderer that computes all at once holds them all."""
MORTON_BITS_MAX = 63
"""A Morton code of a block stays below two to this."""

FAR = 2.0**60
"""Centre, radius and unit of distance stay below it, and a lattice cell below `VOXEL_MAX`: so
positions stay below 2^63, and they and their distances finite in float32.
Numbers of notes stay below it too."""
NEAR = 1 / FAR
VOXEL_MAX = 2.0**32
SPLAT_VALUES = records.SPLAT_VALUES
SPLAT_SCALES = 3
"""Log-scales of a splat; an anchor has twice as many."""
STAGES_MAX = 16
"""Most codes of a splat; each is a row of its own stage of the codebook."""
RESOLUTION_MIN = 2
"""Vertices per axis of a grid: there is a cell to interpolate in."""
TINY = math.ulp(0.0)
ANY = -math.inf
_U32 = (1 << 32) - 1
_I32 = 1 << 31
_POINTERS = 1 << 53
"""Offsets and lengths stay exact in a JavaScript number."""


class Named(IntEnum):
    """Numbers with names for people."""

    @property
    def label(self) -> str:
        """The name used in messages, reports and the documentation."""
        return self.name.lower()


class Kind(Named):
    """Kinds of chunks, by their number in the file."""

    MANIFEST = 1
    DIRECTORY = 2
    NETWORKS = 3
    CODEBOOK = 4
    GRID = 5
    BLOCKS = 6


class Column(Named):
    """Columns of a block, in their order within it; the numbers are not stored."""

    LATTICE = 1
    LOG_SCALES = 2
    CODES = 3
    RESIDUAL = 4
    MASK = 5
    OFFSETS = 6


class CodingId(Named):
    """Codings of floating-point arrays, by their number in the file; `codecs` has the functions."""

    FLOAT = 0
    HALF = 1
    AFFINE8 = 2
    AFFINE16 = 3
    CURVE8 = 4


class Field(NamedTuple):
    """One field of a record: a struct code, its meaning and its range, both ends included."""

    code: str
    meaning: str
    low: float = ANY
    high: float = math.inf


class Header(NamedTuple):
    """The fixed first bytes of a file: sizes of the tables, and the frame."""

    magic: Annotated[bytes, Field("8s", "`GSYN`, CR, LF, 0x1A, LF")]
    version: Annotated[int, Field("I", "version of the format", VERSION, VERSION)]
    required: Annotated[int, Field("I", "bits of features a reader must know", 0, KNOWN_FEATURES)]
    levels: Annotated[int, Field("H", "records in the level table", 1, 16)]
    chunks: Annotated[int, Field("H", "records in the chunk table", 3, 320)]
    slots: Annotated[int, Field("H", "K, slots per anchor", 1, 256)]
    features: Annotated[
        int, Field("H", "F, values per grid entry, 0 without grids; splats: H", 0, 256)
    ]
    residual: Annotated[int, Field("H", "R, residual values per anchor", 0, 1024)]
    contract: Annotated[int, Field("H", "1: space is contracted, 0: it is a box", 0, 1)]
    front: Annotated[int, Field("H", "1: all directories stand before level 0", 0, 1)]
    stand_ins: Annotated[int, Field("H", "s, levels whose splats are stand-ins; 0: none", 0, 15)]
    crc: Annotated[int, Field("I", "CRC-32 of header and tables, this field taken as 0")]
    head: Annotated[int, Field("I", "file offset of level 0's first shared part")]
    voxel: Annotated[float, Field("d", "edge of a lattice cell, world units", NEAR, VOXEL_MAX)]
    center_x: Annotated[float, Field("d", "centre of the frame, world units", -FAR, FAR)]
    center_y: Annotated[float, Field("d", "as above", -FAR, FAR)]
    center_z: Annotated[float, Field("d", "as above", -FAR, FAR)]
    radius: Annotated[float, Field("d", "radius of the frame, world units", NEAR, FAR)]
    extent: Annotated[float, Field("d", "unit of viewing distance, world units", NEAR, FAR)]


class LevelEntry(NamedTuple):
    """One level: its end in the file, its counts and the sizes of its networks."""

    end: Annotated[int, Field("Q", "file offset where this level ends", 1, _POINTERS)]
    anchors: Annotated[int, Field("I", "n, anchors present at this level", 0, _I32 - 1)]
    live: Annotated[int, Field("I", "live slots of this level", 0, _U32)]
    blocks: Annotated[int, Field("I", "spatial blocks of this level", 1, BLOCKS_MAX)]
    grids: Annotated[int, Field("H", "grids read by this level", 0, 64)]
    head_hidden: Annotated[int, Field("H", "hidden width of each head; splats: 0", 0, 4096)]
    fuse_hidden: Annotated[
        int, Field("H", "hidden width of the fusion MLP, 0: there is none", 0, 4096)
    ]
    fuse_out: Annotated[
        int, Field("H", "output width of the fusion MLP, 0: there is none", 0, 4096)
    ]
    codebook_rows: Annotated[int, Field("H", "C, entries of the codebook", 0, 256)]
    codebook_columns: Annotated[int, Field("H", "D, values per entry", 0, 1024)]
    log_scales: Annotated[int, Field("B", "coding of log-scales", 0, max(CodingId))]
    residual: Annotated[int, Field("B", "coding of residual values", 0, max(CodingId))]
    offsets: Annotated[int, Field("B", "coding of offsets", 0, max(CodingId))]
    inherits: Annotated[
        int,
        Field(
            "B", "1: its networks have the matrices of the level before; splats: its codebook", 0, 1
        ),
    ]
    gain_x: Annotated[float, Field("f", "factor on the first scale of Gaussians", TINY)]
    gain_y: Annotated[float, Field("f", "on the second", TINY)]
    gain_z: Annotated[float, Field("f", "on the third", TINY)]


class ChunkEntry(NamedTuple):
    """One chunk: its kind and the place of its bytes; all blocks of a level count as one."""

    kind: Annotated[int, Field("B", "what it holds, see the table of kinds", 1, max(Kind))]
    level: Annotated[int, Field("B", "level that first needs it", 0, 15)]
    coding: Annotated[int, Field("B", "networks, codebook, grid: coding; else 0", 0, max(CodingId))]
    part: Annotated[int, Field("B", "number of the grid; 0 for other kinds", 0, 63)]
    rows: Annotated[int, Field("I", "see the table of kinds", 1, _I32 - 1)]
    offset: Annotated[int, Field("Q", "file offset of the first byte", 0, _POINTERS)]
    stored: Annotated[int, Field("Q", "bytes in the file", 0, _POINTERS)]
    raw: Annotated[int, Field("Q", "bytes after inflating", 0, _POINTERS)]
    crc: Annotated[int, Field("I", "CRC-32 of the stored bytes; 0 for blocks")]
    resolution: Annotated[int, Field("I", "grid: vertices per axis; 0 for other kinds", 0, 1 << 20)]


class BlockEntry(NamedTuple):
    """One spatial block in the directory of its level; the rows per level follow as u32."""

    stored: Annotated[int, Field("I", "bytes in the file", 0, BLOCK_RAW_MAX)]
    raw: Annotated[int, Field("I", "bytes after inflating", 0, BLOCK_RAW_MAX)]
    crc: Annotated[int, Field("I", "CRC-32 of the stored bytes")]
    parent: Annotated[int, Field("I", "block of the level before; 0 at level 0", 0, BLOCKS_MAX - 1)]
    live: Annotated[int, Field("I", "live slots of the block's anchors at this level", 0, _U32)]
    before: Annotated[int, Field("I", "live slots of them at the level before", 0, _U32)]
    low_x: Annotated[int, Field("i", "smallest lattice coordinate of the block's anchors", -_I32)]
    low_y: Annotated[int, Field("i", "as above", -_I32)]
    low_z: Annotated[int, Field("i", "as above", -_I32)]
    high_x: Annotated[int, Field("i", "largest lattice coordinate of the block's anchors", -_I32)]
    high_y: Annotated[int, Field("i", "as above", -_I32)]
    high_z: Annotated[int, Field("i", "as above", -_I32)]
    reach: Annotated[float, Field("f", "how far Gaussians reach beyond that box, world units", 0)]
    width: Annotated[int, Field("I", "bytes of a step between Morton codes, 0: none", 0, 8)]


class PageEntry(NamedTuple):
    """One page of a directory in the level's page table; the rows per level follow as u32."""

    stored: Annotated[int, Field("I", "bytes in the file", 1, BLOCK_RAW_MAX)]
    crc: Annotated[int, Field("I", "CRC-32 of the stored bytes")]
    parent: Annotated[int, Field("I", "page of the level before; 0 at level 0", 0, BLOCKS_MAX - 1)]
    blocks: Annotated[int, Field("I", "blocks in the page", 1, BLOCKS_MAX)]
    parents: Annotated[int, Field("I", "blocks that these divide; 0 at level 0", 0, BLOCKS_MAX)]
    live: Annotated[int, Field("I", "sum of the same of the blocks", 0, _U32)]
    before: Annotated[int, Field("I", "sum of the same of the blocks", 0, _U32)]
    low_x: Annotated[int, Field("i", "corner of a box around those of the blocks", -_I32)]
    low_y: Annotated[int, Field("i", "as above", -_I32)]
    low_z: Annotated[int, Field("i", "as above", -_I32)]
    high_x: Annotated[int, Field("i", "opposite corner", -_I32)]
    high_y: Annotated[int, Field("i", "as above", -_I32)]
    high_z: Annotated[int, Field("i", "as above", -_I32)]
    reach: Annotated[float, Field("f", "at least the same of each block", 0)]
    body: Annotated[int, Field("Q", "sum of the blocks' `stored`", 0, _POINTERS)]
    raw: Annotated[int, Field("Q", "sum of the blocks' `raw`", 0, _POINTERS)]


Record = type[Header] | type[LevelEntry] | type[ChunkEntry] | type[BlockEntry] | type[PageEntry]


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
BLOCK = _struct_of(BlockEntry)
PAGE = _struct_of(PageEntry)


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


def block_entry_bytes(level: int) -> int:
    """Length of a directory's record: the fixed part, then rows new at level 0 … `level`."""
    return BLOCK.size + 4 * (level + 1)


def page_entry_bytes(level: int) -> int:
    """Length of a page table's record: the fixed part, then rows new at level 0 … `level`."""
    return PAGE.size + 4 * (level + 1)


class KindRule(NamedTuple):
    """Rule of a kind of chunk: its array type, the meaning of rows and columns."""

    dtype: str
    rows: str
    columns: str
    meaning: str


KINDS = {
    Kind.MANIFEST: KindRule("u8", "bytes", "1", "UTF-8 JSON, see §3"),
    Kind.DIRECTORY: KindRule(
        "records", "blocks; in pages: pages", "", "directory of a level's blocks, or its page table"
    ),
    Kind.NETWORKS: KindRule("f32", "all weights", "1", "matrices, unless inherited, and biases"),
    Kind.CODEBOOK: KindRule("f32", "C", "D", "the codebook of the level"),
    Kind.GRID: KindRule("f32", "T", "F", "one grid, `part` counts from 0, coarse to fine"),
    Kind.BLOCKS: KindRule("blocks", "blocks", "", "all blocks of the level, and its pages"),
}

COLUMNS = {
    Column.LATTICE: KindRule("i32", "new anchors", "3", "lattice coordinates x, y, z"),
    Column.LOG_SCALES: KindRule("f32", "new anchors", "6; splats: 3", "logarithms of base scales"),
    Column.CODES: KindRule(
        "u8", "new anchors", "1; splats: S", "codebook entries, if there is a codebook"
    ),
    Column.RESIDUAL: KindRule("f32", "new anchors", "R", "continuous features"),
    Column.MASK: KindRule(
        "u8", "ceil(bits / 8)", "1", "live bits of slots that were off before; not with splats"
    ),
    Column.OFFSETS: KindRule(
        "f32", "new live slots", "3", "offsets of slots that became live; not with splats"
    ),
}

CODINGS = {
    CodingId.FLOAT: "float32 as it is",
    CodingId.HALF: "float16, rounded to nearest, ties to even",
    CodingId.AFFINE8: "u8 in equal steps between the extremes of a column",
    CodingId.AFFINE16: "u16 in equal steps between the extremes of a column",
    CodingId.CURVE8: "u8 in steps that widen away from zero",
}
