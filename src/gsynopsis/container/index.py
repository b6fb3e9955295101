"""Header and tables: the plan of chunks that follows from the counts, parsing, every check.

The writer checks its own tables with the same functions, so it never writes what a reader
refuses.
"""

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from gsynopsis.container import layout
from gsynopsis.container.codecs import Bytes
from gsynopsis.container.layout import ChunkEntry, CodingId, Header, Kind, LevelEntry
from gsynopsis.container.values import network_bytes, values_bytes
from gsynopsis.errors import (
    ChecksumError,
    LayoutError,
    NotGsynError,
    TruncatedError,
    ValueRangeError,
    VersionError,
)
from gsynopsis.records import HARMONICS, HEAD_OUTPUTS, network_shapes

CODED = frozenset({Kind.NETWORKS, Kind.CODEBOOK, Kind.GRID})
SPLAT_NUMBERS = 14
"""Values of a splat without spherical harmonics of degree 1 and more."""


@dataclass(frozen=True)
class Index:
    """Header and tables of one file."""

    header: Header
    levels: tuple[LevelEntry, ...]
    chunks: tuple[ChunkEntry, ...]

    @property
    def splats(self) -> bool:
        """True if rows are splats."""
        return has_splats(self.header)

    @property
    def paged(self) -> bool:
        """True if directories are cut into pages."""
        return has_pages(self.header)

    @property
    def length(self) -> int:
        """Bytes of header and tables; the first chunk begins there."""
        return layout.index_bytes(len(self.levels), len(self.chunks))

    def start_of(self, level: int) -> int:
        """File offset where a level's own bytes begin."""
        return self.levels[level - 1].end if level else self.length

    def owner_of(self, level: int) -> int:
        """The level whose chunk holds the matrices of a level's networks, or splats' codebook."""
        while self.levels[level].inherits:
            level -= 1
        return level

    def chunk_of(self, level: int, kind: Kind) -> ChunkEntry:
        """The only chunk of a kind at a level; directories and blocks are always there."""
        return next(c for c in self.chunks if c.level == level and c.kind == kind)

    def anchors_before(self, level: int) -> int:
        """Anchors of the level before, 0 for level 0."""
        return self.levels[level - 1].anchors if level else 0

    def codes_of(self, level: int) -> int:
        """Codes of a row that a level brings: 1 with a codebook, with splats one for each stage."""
        entry = self.levels[level]
        if self.splats:
            return entry.codebook_columns // (self.header.features or 1)
        return int(bool(entry.codebook_rows))


class Want(NamedTuple):
    """A chunk that the counts call for; rows is None where only the chunk itself knows."""

    kind: Kind
    level: int
    part: int
    rows: int | None


def has_splats(header: Header) -> bool:
    """True if rows are splats."""
    return bool(header.required & layout.SPLATS)


def has_pages(header: Header) -> bool:
    """True if directories are cut into pages."""
    return bool(header.required & layout.PAGES)


def input_width(header: Header, level: LevelEntry) -> int:
    """Width of the view-independent features of a level, as `records.input_width`."""
    return level.grids * header.features + level.codebook_columns + header.residual


def shapes_of(header: Header, level: LevelEntry) -> dict[str, tuple[int, ...]]:
    """Names and shapes of a level's networks."""
    fuse = (level.fuse_hidden, level.fuse_out) if level.fuse_hidden else None
    return network_shapes(input_width(header, level), header.slots, level.head_hidden, fuse)


def own_shapes_of(header: Header, level: LevelEntry) -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays in the level's own chunk, in order: biases alone with tied weights."""
    shapes = shapes_of(header, level)
    return {n: shape for n, shape in shapes.items() if len(shape) == 1 or not level.inherits}


def values_per_anchor(header: Header, level: LevelEntry) -> int:
    """Features, hidden values and outputs of one anchor on its way through the networks.

    Of a splat position, log-scales, its other values, and harmonics.
    """
    if has_splats(header):
        return SPLAT_NUMBERS + header.features
    fused = level.fuse_hidden + level.fuse_out
    heads = len(HEAD_OUTPUTS) * level.head_hidden + sum(HEAD_OUTPUTS.values()) * header.slots
    return input_width(header, level) + fused + heads


def plan(header: Header, levels: tuple[LevelEntry, ...]) -> list[Want]:
    """All chunks of a file in their order; an empty codebook is left out."""
    paged = has_pages(header)
    directories = [
        Want(Kind.DIRECTORY, k, 0, None if paged else e.blocks) for k, e in enumerate(levels)
    ]
    wants = [Want(Kind.MANIFEST, 0, 0, None), *(directories if header.front else ())]
    grids = 0
    splats = has_splats(header)
    for number, level in enumerate(levels):
        if not header.front:
            wants.append(directories[number])
        if not splats:
            weights = sum(math.prod(shape) for shape in own_shapes_of(header, level).values())
            wants.append(Want(Kind.NETWORKS, number, 0, weights))
        own = not (splats and level.inherits)
        if own and level.codebook_rows and level.codebook_columns:
            wants.append(Want(Kind.CODEBOOK, number, 0, level.codebook_rows))
        wants += [Want(Kind.GRID, number, part, None) for part in range(grids, level.grids)]
        wants.append(Want(Kind.BLOCKS, number, 0, level.blocks))
        grids = level.grids
    return wants


def first_shared(wants: Sequence[Want]) -> int:
    """The number of the chunk at which `head` ends: the first of level 0 after its directory."""
    before = (Kind.MANIFEST, Kind.DIRECTORY)
    return next(n for n, want in enumerate(wants) if want.kind not in before)


def pack_index(index: Index) -> bytes:
    """Header and tables as bytes, checksum filled in."""
    tables = b"".join(layout.LEVEL.pack(*level) for level in index.levels)
    tables += b"".join(layout.CHUNK.pack(*chunk) for chunk in index.chunks)
    blank = layout.HEADER.pack(*index.header._replace(crc=0))
    crc = zlib.crc32(tables, zlib.crc32(blank))
    return layout.HEADER.pack(*index.header._replace(crc=crc)) + tables


def parse_index(data: Bytes, source: str) -> Index:
    """Header and tables of a file whose first bytes are given, everything checked.

    Raises:
        FormatError: its class names the kind of fault, see `gsynopsis.errors`.
    """
    length = index_length(data, source)
    if len(data) < length:
        raise TruncatedError(source, "index", found=_bytes(len(data)), expected=_bytes(length))
    head = bytes(data[:length])
    header = Header._make(layout.HEADER.unpack_from(head))
    blank = layout.HEADER.pack(*header._replace(crc=0))
    crc = zlib.crc32(head[layout.HEADER.size :], zlib.crc32(blank))
    if crc != header.crc:
        raise ChecksumError(source, "index", found=f"{crc:08x}", expected=f"{header.crc:08x}")
    first = layout.HEADER.size
    second = first + header.levels * layout.LEVEL.size
    levels = tuple(map(LevelEntry._make, layout.LEVEL.iter_unpack(head[first:second])))
    chunks = tuple(map(ChunkEntry._make, layout.CHUNK.iter_unpack(head[second:])))
    index = Index(header, levels, chunks)
    check_levels(header, levels, source)
    check_chunks(index, source)
    return index


def check_length(index: Index, length: int, source: str) -> int:
    """Number of levels in a file of this length, at least one.

    Raises:
        TruncatedError: the length is not the end of a level.
    """
    ends = [level.end for level in index.levels]
    if length not in ends:
        expected = f"the end of a level ({', '.join(map(str, ends))})"
        advice = "fetch the file again"
        raise TruncatedError(
            source, "length", found=_bytes(length), expected=expected, advice=advice
        )
    return ends.index(length) + 1


def index_length(data: Bytes, source: str) -> int:
    """Length of header and tables in bytes, from at least the bytes of the header."""
    magic = bytes(data[: len(layout.MAGIC)])
    if magic != layout.MAGIC[: len(magic)]:
        raise NotGsynError(
            source, found=magic, expected=layout.MAGIC, advice="this is no .gsyn file"
        )
    if len(data) < layout.HEADER.size:
        size = layout.HEADER.size
        raise TruncatedError(source, "header", found=_bytes(len(data)), expected=_bytes(size))
    header = Header._make(layout.HEADER.unpack_from(data))
    newer = "a newer gsynopsis wrote this file; update"
    if header.version != layout.VERSION:
        found, known = header.version, layout.VERSION
        raise VersionError(source, "version", found=found, expected=known, advice=newer)
    unknown = header.required & ~layout.KNOWN_FEATURES
    if unknown:
        raise VersionError(source, "required", found=f"{unknown:#x}", expected=0, advice=newer)
    check_ranges(header, "header", source)
    length = layout.index_bytes(header.levels, header.chunks)
    if length > layout.INDEX_BYTES_MAX:
        most = f"at most {layout.INDEX_BYTES_MAX}"
        raise LayoutError(source, "index", found=_bytes(length), expected=most)
    return length


def check_ranges(record: NamedTuple, where: str, source: str) -> None:
    """Every field of a record lies in the range that layout.py gives it."""
    for (name, field), value in zip(layout.fields_of(type(record)).items(), record, strict=True):  # type: ignore[arg-type]
        if isinstance(value, float):
            if not math.isfinite(value) or not field.low <= value <= field.high:
                bounds = f"{field.low:g} to {field.high:g}"
                expected = bounds if math.isfinite(field.high) else "finite and > 0"
                raise ValueRangeError(source, f"{where}: {name}", found=value, expected=expected)
        elif isinstance(value, int) and not field.low <= value <= field.high:
            expected = f"{field.low} to {field.high}"
            raise LayoutError(source, f"{where}: {name}", found=value, expected=expected)


def check_levels(header: Header, levels: tuple[LevelEntry, ...], source: str) -> None:
    """The counts of the levels are nested and can be."""
    _check_inherited(header, levels, source)
    _check_stand_ins(header, source)
    if has_splats(header):
        _check_splats(header, levels, source)
    else:
        _check_anchors(header, levels, source)
    anchors = live = grids = 0
    for number, level in enumerate(levels):
        where = f"level {number}"
        check_ranges(level, where, source)
        if bool(level.fuse_hidden) != bool(level.fuse_out):
            raise LayoutError(
                source, f"{where}: fuse_out", found=level.fuse_out, expected="0 with fuse_hidden"
            )
        nested = (("anchors", anchors), ("live", live), ("grids", grids))
        for name, least in nested:
            found = getattr(level, name)
            if found < least:
                expected = f"at least {least}, as the level before"
                raise LayoutError(source, f"{where}: {name}", found=found, expected=expected)
        least, most = live + level.anchors - anchors, level.anchors * header.slots
        if not least <= level.live <= most:
            expected = f"{least} to {most}"
            raise LayoutError(source, f"{where}: live", found=level.live, expected=expected)
        if level.blocks > (most := max(1, level.anchors)):
            found, expected = level.blocks, f"at most {most}, an anchor each"
            raise LayoutError(source, f"{where}: blocks", found=found, expected=expected)
        anchors, live, grids = level.anchors, level.live, level.grids


def _check_anchors(header: Header, levels: tuple[LevelEntry, ...], source: str) -> None:
    """Check the rules that levels of anchors share."""
    coded = {bool(level.codebook_rows) for level in levels if level.anchors}
    if len(coded) > 1:
        raise LayoutError(source, "codebook_rows", found="0 at some levels", expected="at all")
    if bool(header.features) != bool(levels[-1].grids):
        found, grids = header.features, levels[-1].grids
        raise LayoutError(source, "header: features", found=found, expected=f"for {grids} grids")
    for number, level in enumerate(levels):
        if not level.head_hidden:
            where = f"level {number}: head_hidden"
            raise LayoutError(source, where, found=0, expected="at least 1")


def _check_splats(header: Header, levels: tuple[LevelEntry, ...], source: str) -> None:
    """Check the rules of levels of splats, which have no networks and no grids."""
    _expect(header.slots, 1, "header: slots", source)
    _expect(header.residual, layout.SPLAT_VALUES, "header: residual", source)
    _expect(header.contract, 0, "header: contract", source)
    if header.features not in HARMONICS:
        expected = " or ".join(map(str, HARMONICS))
        raise LayoutError(source, "header: features", found=header.features, expected=expected)
    for number, level in enumerate(levels):
        where = f"level {number}"
        for name in ("grids", "head_hidden", "fuse_hidden", "fuse_out", "offsets"):
            _expect(getattr(level, name), 0, f"{where}: {name}", source)
        _expect(level.live, level.anchors, f"{where}: live", source)
        stages = level.codebook_columns // (header.features or 1)
        whole = stages * header.features == level.codebook_columns
        fits = bool(level.codebook_rows) == bool(level.codebook_columns)
        if not (whole and fits and stages <= layout.STAGES_MAX):
            found = f"{level.codebook_rows} rows of {level.codebook_columns}"
            expected = f"rows of 1 to {layout.STAGES_MAX} times {header.features} values, or none"
            raise LayoutError(source, f"{where}: codebook_rows", found=found, expected=expected)


def _check_stand_ins(header: Header, source: str) -> None:
    """Stand-ins are splats, some level is without, and readers that know none are warned."""
    bit = int(header.stand_ins > 0) * layout.STAND_INS
    _expect(header.required & layout.STAND_INS, bit, "header: required", source)
    most = header.levels - 1 if has_splats(header) else 0
    if header.stand_ins > most:
        expected = f"at most {most}"
        raise LayoutError(source, "header: stand_ins", found=header.stand_ins, expected=expected)


def _check_inherited(header: Header, levels: tuple[LevelEntry, ...], source: str) -> None:
    """Matrices can be those of the level before, and readers that know no such thing are warned."""
    bit = int(any(level.inherits for level in levels)) * layout.TIED_WEIGHTS
    _expect(header.required & layout.TIED_WEIGHTS, bit, "header: required", source)
    for number, level in enumerate(levels):
        if level.inherits:
            where = f"level {number}: inherits"
            if not number:
                raise LayoutError(source, where, found=1, expected="0 at level 0")
            before = levels[number - 1]
            if has_splats(header):
                sizes = (level.codebook_rows, level.codebook_columns)
                same = sizes == (before.codebook_rows, before.codebook_columns) != (0, 0)
                if not same:
                    expected = "0, or a codebook of the same size"
                    raise LayoutError(source, where, found=level.inherits, expected=expected)
            elif shapes_of(header, level) != shapes_of(header, before):
                expected = "0, or networks of the same sizes"
                raise LayoutError(source, where, found=level.inherits, expected=expected)


def check_chunks(index: Index, source: str) -> None:
    """The chunk table is the plan of the counts, without a gap, and claims what can be."""
    wants = plan(index.header, index.levels)
    if len(wants) != len(index.chunks):
        raise LayoutError(source, "header: chunks", found=len(index.chunks), expected=len(wants))
    shared = first_shared(wants)
    offset, raw, resolution = index.length, 0, layout.RESOLUTION_MIN - 1
    for number, (want, chunk) in enumerate(zip(wants, index.chunks, strict=True)):
        where = f"chunk {number}"
        check_ranges(chunk, where, source)
        _check_wanted(want, chunk, where, source)
        _expect(chunk.offset, offset, f"{where}: offset", source)
        _check_sizes(index, chunk, f"{where} ({name_of(chunk)})", source)
        if want.kind is Kind.GRID:
            if chunk.resolution <= resolution:
                expected = f"more than {resolution}"
                found = chunk.resolution
                raise LayoutError(source, f"{where}: resolution", found=found, expected=expected)
            resolution = chunk.resolution
        else:
            _expect(chunk.resolution, 0, f"{where}: resolution", source)
        if number == shared:
            _expect(index.header.head, offset, "header: head", source)
        offset, raw = offset + chunk.stored, raw + chunk.raw
        if want.kind is Kind.BLOCKS:
            _check_level_end(index, want.level, offset, raw, source)


def name_of(chunk: ChunkEntry) -> str:
    """Name of a chunk in messages."""
    kind = Kind(chunk.kind)
    if kind is Kind.MANIFEST:
        return kind.label
    return f"level {chunk.level} {kind.label}" + (f" {chunk.part}" if kind is Kind.GRID else "")


def columns_of(index: Index, chunk: ChunkEntry) -> int:
    """Values per row of a codebook or grid, 1 for other kinds."""
    if chunk.kind == Kind.CODEBOOK:
        return index.levels[chunk.level].codebook_columns
    return index.header.features if chunk.kind == Kind.GRID else 1


def _check_wanted(want: Want, chunk: ChunkEntry, where: str, source: str) -> None:
    _expect(chunk.kind, int(want.kind), f"{where}: kind", source)
    _expect(chunk.level, want.level, f"{where}: level", source)
    _expect(chunk.part, want.part, f"{where}: part", source)
    if want.rows is not None:
        _expect(chunk.rows, want.rows, f"{where}: rows", source)


def _check_sizes(index: Index, chunk: ChunkEntry, where: str, source: str) -> None:
    """Check the raw length against counts and coding; the stored length is never larger."""
    kind, coding = Kind(chunk.kind), CodingId(chunk.coding)
    if kind not in CODED:
        _expect(chunk.coding, 0, f"{where}: coding", source)
    if kind is not Kind.BLOCKS:
        _expect(chunk.raw, _raw_length(index, chunk, coding), f"{where}: raw", source)
    if chunk.stored > chunk.raw:
        most = f"at most {chunk.raw}"
        raise LayoutError(source, f"{where}: stored", found=chunk.stored, expected=most)
    if chunk.stored == 0 and chunk.raw:
        raise LayoutError(source, f"{where}: stored", found=0, expected="at least 1")
    if kind is Kind.MANIFEST and chunk.raw > layout.MANIFEST_BYTES_MAX:
        most = f"at most {layout.MANIFEST_BYTES_MAX}"
        raise LayoutError(source, f"{where}: raw", found=chunk.raw, expected=most)
    if kind is Kind.BLOCKS:
        _expect(chunk.crc, 0, f"{where}: crc", source)


def _raw_length(index: Index, chunk: ChunkEntry, coding: CodingId) -> int:
    match Kind(chunk.kind):
        case Kind.MANIFEST:
            return chunk.rows
        case Kind.DIRECTORY:
            table = layout.page_entry_bytes if index.paged else layout.block_entry_bytes
            return chunk.rows * table(chunk.level)
        case Kind.NETWORKS:
            shapes = own_shapes_of(index.header, index.levels[chunk.level])
            return network_bytes(coding, shapes)
        case _:
            return values_bytes(coding, chunk.rows, columns_of(index, chunk))


def _check_level_end(index: Index, number: int, end: int, raw: int, source: str) -> None:
    """Check the end of a level, and that its counts are in proportion to its bytes."""
    where, level = f"level {number}", index.levels[number]
    _expect(level.end, end, f"{where}: end", source)
    most = layout.RAW_BYTES_BASE + layout.EXPANSION_MAX * end
    if raw > most:
        raise LayoutError(source, f"{where}: raw", found=_bytes(raw), expected=f"at most {most}")
    slots = level.anchors * index.header.slots
    most = layout.SLOTS_BASE + layout.EXPANSION_MAX * end
    if slots > most:
        raise LayoutError(source, f"{where}: slots", found=slots, expected=f"at most {most}")
    values = level.anchors * values_per_anchor(index.header, level)
    most = layout.VALUES_BASE + layout.VALUES_EXPANSION_MAX * end
    if values > most:
        raise LayoutError(source, f"{where}: values", found=values, expected=f"at most {most}")


def _expect(found: int, expected: int, where: str, source: str) -> None:
    if found != expected:
        raise LayoutError(source, where, found=found, expected=expected)


def _bytes(count: int) -> str:
    return f"{count} bytes"
