"""A file, or a prefix of one, to a `LevelSet`; everything checked."""

import os
from pathlib import Path

from gsynopsis.errors import InputError
from gsynopsis.pack.assembler import Assembler
from gsynopsis.pack.codecs import Bytes
from gsynopsis.pack.index import Index, check_length, parse_index
from gsynopsis.pack.layout import INDEX_BYTES_MAX
from gsynopsis.records import LevelSet


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
    view = memoryview(data)
    assembler = Assembler(view, source)
    last = last_level(assembler.index, len(view), level, source)
    for number in range(last + 1):
        assembler.add_level(view)
        assert assembler.levels_ready == number + 1
    return assembler.level_set()


def read_gsyn(path: Path | str, level: int | None = None) -> LevelSet:
    """The level set in a file; reads, and checks, only the bytes of the levels wanted.

    Args:
        path: A .gsyn file, or a prefix of one that ends after a level.
        level: Last level wanted; None for all that the file holds.

    Raises:
        FormatError: the file breaks a promise of docs/format.md.
        InputError: there is no such file or level.
    """
    source = str(path)
    try:
        with Path(path).open("rb") as file:
            length = os.fstat(file.fileno()).st_size
            index = parse_index(file.read(INDEX_BYTES_MAX), source)
            last = last_level(index, length, level, source)
            file.seek(0)
            data = file.read(index.levels[last].end)
    except OSError as error:
        found = error.strerror or error
        raise InputError(path, found=found, expected="a readable .gsyn file") from error
    return decode(data, source)


def last_level(index: Index, length: int, level: int | None, source: str) -> int:
    """The number of the last level to decode, from the length of what is there.

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
