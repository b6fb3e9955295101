"""Files that users and other files name: regular ones, within a folder, no larger than asked."""

import json
import os
import re
import zipfile
import zlib
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from gsynopsis.errors import InputError
from gsynopsis.files import open_regular
from gsynopsis.formats.readers.base import shown

INFLATED_FREE = 1 << 24
"""Most bytes of an entry of a small zip; else the size of the zip, as images barely shrink."""
DEPTH_MAX = 200
"""Most arrays and objects within each other."""
STRING = re.compile(rb'"[^"\\]*(?:\\.[^"\\]*)*"', re.DOTALL)


class Files(Protocol):
    """Files that belong together, by name."""

    @property
    def stored(self) -> int:
        """Bytes on the disk of what was read so far, each file once."""
        ...

    def read(self, name: str, most: int) -> bytes:
        """A file's bytes, `most` at most.

        Raises:
            InputError: there is none, it is larger, or no regular one.
        """
        ...


class Folder:
    """Files of a folder, and of none beside it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._sizes: dict[tuple[int, int], int] = {}

    @property
    def stored(self) -> int:
        """Bytes of the files that were read, each once under however many names."""
        return sum(self._sizes.values())

    def read(self, name: str, most: int) -> bytes:
        """See `Files`."""
        inner = self.path / name
        try:
            within = inner.resolve().is_relative_to(self.path.resolve())
        except (OSError, RuntimeError, ValueError) as error:  # circles of links, a NUL
            raise InputError(shown(inner), found=error, expected="a file") from error
        if not within:
            raise InputError(inner, found="a path out of the folder", expected="one within")
        with open_regular(inner, expected="a file") as file:
            state = os.fstat(file.fileno())
            if state.st_size > most:
                found = f"{state.st_size:,} bytes"
                raise InputError(inner, found=found, expected=f"at most {most:,}")
            self._sizes[state.st_dev, state.st_ino] = state.st_size
            return file.read(most)


class Bundle:
    """Files of a zip."""

    def __init__(self, bundle: zipfile.ZipFile, path: Path, size: int) -> None:
        self.bundle, self.path, self.stored = bundle, path, size

    def read(self, name: str, most: int) -> bytes:
        """See `Files`."""
        most = min(most, max(INFLATED_FREE, self.stored))
        try:
            info = self.bundle.getinfo(name)
            if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                found = f"compression {info.compress_type}"
                raise InputError(self.path, name, found=found, expected="none or DEFLATE")
            if info.file_size > most:
                found = f"{info.file_size:,} bytes"
                raise InputError(self.path, name, found=found, expected=f"at most {most:,}")
            with self.bundle.open(info) as file:
                return file.read(most)
        except KeyError as error:
            raise InputError(self.path, name, found="nothing", expected="a file in it") from error
        except (zlib.error, EOFError, OSError) as error:
            raise InputError(self.path, name, found=error, expected="a whole file in it") from error


def parsed(text: bytes, path: Path) -> dict[str, Any]:
    """A JSON object, not deeper than `DEPTH_MAX`.

    Raises:
        InputError: it is none.
    """
    marks = np.frombuffer(STRING.sub(b"", text), np.uint8)
    steps = np.isin(marks, list(b"[{")).astype(np.int8) - np.isin(marks, list(b"]}"))
    if len(steps) and int(np.cumsum(steps, dtype=np.int32).max()) > DEPTH_MAX:
        expected = f"arrays and objects at most {DEPTH_MAX} deep"
        raise InputError(path, found="deeper JSON", expected=expected)
    try:
        meta = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(path, found=shown(error), expected="JSON") from error
    if not isinstance(meta, dict):
        raise InputError(path, found="other JSON", expected="an object")
    return meta
