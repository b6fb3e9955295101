"""A file, or a prefix of one, to a `LevelSet`; everything checked."""

import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from gsynopsis.container.assembler import Assembler
from gsynopsis.container.codecs import Bytes
from gsynopsis.container.index import Index, check_length, parse_index
from gsynopsis.container.layout import INDEX_BYTES_MAX
from gsynopsis.errors import InputError
from gsynopsis.files import open_regular
from gsynopsis.records import LevelSet

READABLE = "a readable .gsyn file"


def decode(data: Bytes, source: str, level: int | None = None) -> LevelSet:
    """The level set in the bytes of a file, or of a prefix that ends after a level.

    Args:
        data: The bytes; not modified, not kept.
        source: What messages call them, usually the path.
        level: Last level wanted; None for all that the bytes hold.

    Raises:
        FormatError: the bytes break a promise of docs/format.md.
        InputError: the level is not in there.
    """
    return assembled(memoryview(data), source, level).level_set()


class GsynFile:
    """A .gsyn file on a disk, or a prefix of one, whose index and length are already checked.

    Its slices are read when they are asked for, so a file that lies about itself is refused at
    the first chunk that does not keep what the tables promise, however long it is.

    Attributes:
        index: Header and tables.
        held: How many levels it holds, at least one.
    """

    def __init__(self, file: BinaryIO, length: int, source: str) -> None:
        """Read header and tables of a file of `length` bytes; see `open_gsyn`."""
        self._file, self._length = file, length
        self.index = parse_index(file.read(INDEX_BYTES_MAX), source)
        self.held = check_length(self.index, length, source)

    def __len__(self) -> int:
        return self._length

    def __getitem__(self, span: slice) -> bytes:
        start, stop, _ = span.indices(self._length)
        self._file.seek(start)
        return self._file.read(stop - start)


@contextmanager
def open_gsyn(path: Path | str) -> Generator[GsynFile]:
    """A file on disk, open for reading, its header already checked.

    Raises:
        FormatError: header, tables or length break a promise of docs/format.md.
        InputError: there is no such file, it is not a regular one, or it cannot be read.
    """
    try:
        with open_regular(path, expected=READABLE) as file:
            yield GsynFile(file, os.fstat(file.fileno()).st_size, str(path))
    except OSError as error:
        raise InputError(path, found=error.strerror or error, expected=READABLE) from error


def read_gsyn(path: Path | str, level: int | None = None) -> LevelSet:
    """The level set in a file; reads, and checks, only the bytes of the levels wanted.

    Args:
        path: A .gsyn file, or a prefix of one that ends after a level.
        level: Last level wanted; None for all that the file holds.

    Raises:
        FormatError: the file breaks a promise of docs/format.md.
        InputError: there is no such file or level.
    """
    with open_gsyn(path) as file:
        return assembled(file, str(path), level).level_set()


def read_bytes(path: Path | str) -> bytes:
    """The bytes of a file, or of a prefix of it, after a check of everything in them.

    Raises:
        FormatError: the file breaks a promise of docs/format.md.
        InputError: there is no such file.
    """
    with open_gsyn(path) as file:
        assembled(file, str(path))
        return file[:]


def assembled(data: Bytes | GsynFile, source: str, level: int | None = None) -> Assembler:
    """All that the bytes of a file, or a file itself, hold up to a level.

    Raises:
        FormatError: the bytes break a promise of docs/format.md.
        InputError: the level is not in there.
    """
    head = data.index if isinstance(data, GsynFile) else data[:INDEX_BYTES_MAX]
    assembler = Assembler(head, source)
    last = last_level(assembler.index, len(data), level, source)
    for number in range(last + 1):
        assembler.add_level(data)
        assert assembler.levels_ready == number + 1
    return assembler


def last_level(index: Index, length: int, level: int | None, source: str) -> int:
    """The number of the last level to decode, from the length of the file.

    Raises:
        TruncatedError: the length is not the end of a level.
        InputError: the level is not in there.
    """
    held = check_length(index, length, source)
    if level is None:
        return held - 1
    if not 0 <= level < held:
        raise InputError(source, "level", found=level, expected=f"0 to {held - 1}")
    return level
