"""Files from files, without coding anything again: other notes, a prefix, one file per level."""

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from gsynopsis.container.assembler import Assembler
from gsynopsis.container.codecs import deflate
from gsynopsis.container.index import Index, check_chunks, check_length, pack_index, parse_index
from gsynopsis.container.manifest import manifest_text
from gsynopsis.container.reader import last_level, read_bytes, read_gsyn
from gsynopsis.container.writer import publish
from gsynopsis.errors import InputError
from gsynopsis.records import LevelSet


@dataclass(frozen=True)
class Piece:
    """One of the files of `split`: its name and the bytes of the whole file that it holds."""

    path: Path
    start: int
    stop: int


def annotated(
    data: bytes,
    meta: Mapping[str, str],
    quality: Sequence[Mapping[str, float]] | None,
    source: str,
) -> bytes:
    """A packed file with notes, and the measured quality of each level, in its manifest.

    Every chunk but the manifest keeps its bytes.

    Args:
        data: The file; not modified.
        meta: Notes to add or to change.
        quality: Figures of every level of the whole file; None keeps those there are.
        source: What messages call the file.

    Raises:
        FormatError: the file is damaged.
        ValueRangeError: a figure is not finite, or the manifest would be too long.
    """
    assembler = Assembler(data, source)
    index = assembler.index
    old = index.chunks[0]
    assembler.add(old, data[old.offset : old.offset + old.stored])
    figures = assembler.quality if quality is None else [dict(level) for level in quality]
    text = manifest_text({**assembler.meta, **meta}, figures, len(index.levels), source)
    stored = deflate(text)[0]
    moved = _moved(index, len(text), stored)
    check_chunks(moved, source)
    return b"".join([pack_index(moved), stored, data[old.offset + old.stored :]])


def _moved(index: Index, raw: int, stored: bytes) -> Index:
    """The tables for another manifest; all that follows it moves."""
    old = index.chunks[0]
    by = len(stored) - old.stored
    first = old._replace(rows=raw, raw=raw, stored=len(stored), crc=zlib.crc32(stored))
    chunks = (first, *(c._replace(offset=c.offset + by) for c in index.chunks[1:]))
    levels = tuple(level._replace(end=level.end + by) for level in index.levels)
    return Index(index.header._replace(head=index.header.head + by), levels, chunks)


def cut_file(path: Path, level: int, out: Path) -> int:
    """Write the beginning of a file, to the end of a level; returns its length in bytes.

    Raises:
        FormatError: the file is damaged.
        InputError: the level is not in there, or a path can not be used.
        SpaceError: the disk has no room.
    """
    data = read_bytes(path)
    index = parse_index(data, str(path))
    end = index.levels[last_level(index, len(data), level, str(path))].end
    if out.exists() and out.samefile(path):
        raise InputError(out, found="the file that is cut", expected="another name")
    publish(data[:end], out)
    return end


def split_file(path: Path, folder: Path) -> list[Piece]:
    """Write one file per level, for hosts that do not serve ranges.

    The first is a .gsyn file of level 0; each further one holds the bytes that the next level
    adds. Joined in order they are the file again.

    Raises:
        FormatError: the file is damaged.
        InputError: a path can not be used.
        SpaceError: the disk has no room.
    """
    data = read_bytes(path)
    index = parse_index(data, str(path))
    held = check_length(index, len(data), str(path))
    pieces: list[Piece] = []
    start = 0
    for number, level in enumerate(index.levels[:held]):
        suffix = ".gsyn" if number == 0 else ".delta"
        piece = Piece(folder / f"{path.stem}.L{number}{suffix}", start, level.end)
        publish(data[start : level.end], piece.path)
        pieces.append(piece)
        start = level.end
    return pieces


def check_file(path: Path) -> LevelSet:
    """Check all that docs/format.md promises of a file; returns its contents.

    Raises:
        FormatError: it breaks a promise; the class says which.
        InputError: it can not be read.
    """
    return read_gsyn(path)
