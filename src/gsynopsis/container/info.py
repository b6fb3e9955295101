"""Description of a file, read from its index and manifest alone."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gsynopsis.container.assembler import Assembler
from gsynopsis.container.blocks import column_bytes, column_values, shape_of
from gsynopsis.container.codecs import section_sizes
from gsynopsis.container.index import CODED, Index, columns_of
from gsynopsis.container.layout import CodingId, Column, Kind
from gsynopsis.container.reader import GsynFile, assembled, open_gsyn


@dataclass(frozen=True)
class PartInfo:
    """The chunks of one kind, or one column of all blocks, at one level.

    Attributes:
        kind: Name of the kind or column, as in docs/format.md.
        coding: Name of its coding, several joined by `+`; empty where there is but one.
        chunks: How many chunks or blocks.
        values: Numbers in them.
        raw: Bytes before deflating.
        stored: Bytes in the file.
        bits_per_value: 8 × stored / values.
    """

    kind: str
    coding: str
    chunks: int
    values: int
    raw: int
    stored: int
    bits_per_value: float


@dataclass(frozen=True)
class LevelInfo:
    """One level of a file; `bytes` is the length of the prefix, `delta` what the level adds."""

    level: int
    anchors: int
    slots: int
    blocks: int
    grids: int
    bytes: int
    delta: int
    quality: dict[str, float]
    parts: tuple[PartInfo, ...]


@dataclass(frozen=True)
class FileInfo:
    """A whole file, for printing; `dataclasses.asdict` makes it ready for JSON.

    Attributes:
        path: The file.
        version: Version of the format.
        bytes: Length of the file.
        index_bytes: Header and tables.
        head_bytes: All before level 0's first shared part.
        levels_total: Levels of the whole file; more than `levels` holds if this is a prefix.
        slots_per_anchor: K.
        stand_ins: Levels whose splats finer ones do not show; 0 with anchors.
        voxel: Edge of a lattice cell, world units.
        contract: Whether space is contracted.
        meta: What the writer noted, e.g. `scene` and `generator`.
        levels: The levels that the file holds, coarsest first.
    """

    path: str
    version: int
    bytes: int
    index_bytes: int
    head_bytes: int
    levels_total: int
    slots_per_anchor: int
    stand_ins: int
    voxel: float
    contract: bool
    meta: dict[str, str]
    levels: tuple[LevelInfo, ...]


def describe(path: Path | str) -> FileInfo:
    """Description of a file; everything in it is checked, as by `check_file`.

    Raises:
        FormatError: the file breaks a promise of docs/format.md.
        InputError: there is no such file.
    """
    source = str(path)
    with open_gsyn(path) as file:
        length = len(file)
        assembler = assembled(file, source)
        assembler.level_set()
        index = assembler.index
        levels: list[LevelInfo] = []
        for number in range(file.held):
            parts = _shared_parts(index, number) + _page_parts(assembler, number)
            parts += _block_parts(assembler, number, file)
            levels.append(_level_info(assembler, number, parts))
    header = index.header
    return FileInfo(
        path=source,
        version=header.version,
        bytes=length,
        index_bytes=index.length,
        head_bytes=header.head,
        levels_total=len(index.levels),
        slots_per_anchor=header.slots,
        stand_ins=header.stand_ins,
        voxel=header.voxel,
        contract=bool(header.contract),
        meta=assembler.meta,
        levels=tuple(levels),
    )


def _level_info(assembler: Assembler, number: int, parts: tuple[PartInfo, ...]) -> LevelInfo:
    index = assembler.index
    entry = index.levels[number]
    return LevelInfo(
        level=number,
        anchors=entry.anchors,
        slots=entry.live,
        blocks=entry.blocks,
        grids=entry.grids,
        bytes=entry.end,
        delta=entry.end - (index.levels[number - 1].end if number else 0),
        quality=assembler.quality[number],
        parts=parts,
    )


def _shared_parts(index: Index, number: int) -> tuple[PartInfo, ...]:
    """Sizes of a level's chunks other than blocks; level 0 includes those at the front."""
    start, end = index.start_of(number), index.levels[number].end
    chunks = [c for c in index.chunks if start <= c.offset < end and c.kind != Kind.BLOCKS]
    parts: list[PartInfo] = []
    for kind in dict.fromkeys(chunk.kind for chunk in chunks):
        own = [chunk for chunk in chunks if chunk.kind == kind]
        codings = dict.fromkeys(CodingId(c.coding).label for c in own if c.kind in CODED)
        values = sum(chunk.rows * columns_of(index, chunk) for chunk in own)
        sizes = (sum(chunk.raw for chunk in own), sum(chunk.stored for chunk in own))
        parts.append(_part(Kind(kind).label, "+".join(codings), len(own), values, sizes))
    return tuple(parts)


def _page_parts(assembler: Assembler, number: int) -> tuple[PartInfo, ...]:
    """The pages of a level's directory, if it is in pages."""
    if number not in assembler.pages:
        return ()
    table, records = assembler.pages[number], assembler.directories[number].records
    sizes = (records.nbytes, int(table.records["stored"].sum(dtype=np.int64)))
    return (_part("pages", "", len(table), len(records), sizes),)


def _block_parts(assembler: Assembler, number: int, file: GsynFile) -> tuple[PartInfo, ...]:
    """The columns of a level's blocks; what each takes is read off the DEFLATE streams."""
    directory, index = assembler.directories[number], assembler.index
    entry = index.levels[number]
    codings = {
        Column.LOG_SCALES: CodingId(entry.log_scales).label,
        Column.RESIDUAL: CodingId(entry.residual).label,
        Column.OFFSETS: CodingId(entry.offsets).label,
    }
    tally = {column: [0, 0, 0] for column in Column}
    for block, record in enumerate(directory.records):
        shape = shape_of(index, number, record)
        raw = column_bytes(shape)
        first, last = directory.span_of(block)
        stored = section_sizes(file[first:last], list(raw.values()))
        for (column, length), taken in zip(raw.items(), stored, strict=True):
            counts = (column_values(shape)[column], length, taken)
            tally[column] = [a + b for a, b in zip(tally[column], counts, strict=True)]
    count = len(directory)
    return tuple(
        _part(column.label, codings.get(column, ""), count, values, (raw, stored))
        for column, (values, raw, stored) in tally.items()
        if raw
    )


def _part(kind: str, coding: str, chunks: int, values: int, sizes: tuple[int, int]) -> PartInfo:
    raw, stored = sizes
    return PartInfo(kind, coding, chunks, values, raw, stored, 8 * stored / max(1, values))
