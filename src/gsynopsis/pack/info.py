"""What a file says about itself, read from its index and manifest alone."""

import os
from dataclasses import dataclass
from pathlib import Path

from gsynopsis.errors import InputError
from gsynopsis.pack.index import Index, check_length
from gsynopsis.pack.layout import INDEX_BYTES_MAX, ChunkEntry, CodingId, Kind
from gsynopsis.pack.reader import Assembler


@dataclass(frozen=True)
class PartInfo:
    """The chunks of one kind at one level.

    Attributes:
        kind: Name of the kind, as in docs/format.md.
        coding: Name of its coding, several joined by `+`.
        chunks: How many chunks.
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
        coding: `raw` if every chunk is plain, else `compact`.
        levels_total: Levels of the whole file; more than `levels` holds if this is a prefix.
        slots_per_anchor: K.
        voxel: Edge of a lattice cell, world units.
        contract: Whether space is contracted.
        meta: What the writer noted, e.g. `scene` and `generator`.
        levels: The levels that the file holds, coarsest first.
    """

    path: str
    version: int
    bytes: int
    index_bytes: int
    coding: str
    levels_total: int
    slots_per_anchor: int
    voxel: float
    contract: bool
    meta: dict[str, str]
    levels: tuple[LevelInfo, ...]


def describe(path: Path | str) -> FileInfo:
    """What is in a file; checks header, tables, manifest and length, not the other chunks.

    Raises:
        FormatError: the file breaks a promise of docs/format.md.
        InputError: there is no such file.
    """
    source = str(path)
    try:
        with Path(path).open("rb") as file:
            length = os.fstat(file.fileno()).st_size
            assembler = Assembler(file.read(INDEX_BYTES_MAX), source)
            index = assembler.index
            held = check_length(index, length, source)
            file.seek(index.chunks[0].offset)
            assembler.add(file.read(index.chunks[0].stored))
    except OSError as error:
        found = error.strerror or error
        raise InputError(path, found=found, expected="a readable .gsyn file") from error
    plain = all(chunk.coding == CodingId.PLAIN for chunk in index.chunks)
    return FileInfo(
        path=source,
        version=index.header.version,
        bytes=length,
        index_bytes=index.length,
        coding="raw" if plain else "compact",
        levels_total=len(index.levels),
        slots_per_anchor=index.header.slots,
        voxel=index.header.voxel,
        contract=bool(index.header.contract),
        meta=assembler.meta,
        levels=tuple(_level_info(index, k, assembler.quality[k]) for k in range(held)),
    )


def _level_info(index: Index, number: int, quality: dict[str, float]) -> LevelInfo:
    entry, chunks = index.levels[number], index.chunks_of(number)
    kinds = list(dict.fromkeys(chunk.kind for chunk in chunks))
    return LevelInfo(
        level=number,
        anchors=entry.anchors,
        slots=entry.live,
        grids=entry.grids,
        bytes=entry.end,
        delta=entry.end - (index.levels[number - 1].end if number else 0),
        quality=quality,
        parts=tuple(_part_info([c for c in chunks if c.kind == kind]) for kind in kinds),
    )


def _part_info(chunks: list[ChunkEntry]) -> PartInfo:
    codings = dict.fromkeys(CodingId(chunk.coding).label for chunk in chunks)
    values = sum(chunk.rows * chunk.columns for chunk in chunks)
    stored = sum(chunk.stored for chunk in chunks)
    return PartInfo(
        kind=Kind(chunks[0].kind).label,
        coding="+".join(codings),
        chunks=len(chunks),
        values=values,
        raw=sum(chunk.raw for chunk in chunks),
        stored=stored,
        bits_per_value=8 * stored / values,
    )
