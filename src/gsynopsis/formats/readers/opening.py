"""Files that users and other files name: regular ones, within a folder, no larger than asked."""

import json
import os
import re
import stat
import zipfile
import zlib
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import numpy as np

from gsynopsis.errors import InputError
from gsynopsis.formats.readers.base import shown

INFLATED_FREE = 1 << 24
"""Bytes that an entry of a small zip may have; else as many as the zip: pictures do not shrink."""
DEPTH_MAX = 200
"""Of arrays and objects within each other."""
STRING = re.compile(rb'"[^"\\]*(?:\\.[^"\\]*)*"', re.DOTALL)


class Files(Protocol):
    """Files that belong together, by name."""

    @property
    def stored(self) -> int:
        """Bytes on the disk of what was read so far, each file once."""
        ...

    def read(self, name: str, most: int) -> bytes:
        """A file of at most so many bytes.

        Raises:
            InputError: there is none, it is larger, or no regular one.
        """
        ...


def open_regular(path: Path, folder: Path | None = None) -> BinaryIO:
    """A regular file, open; what else has a name, as pipes and devices, is not even opened.

    Args:
        path: The file.
        folder: The file has to be within, links followed; None: anywhere.

    Raises:
        InputError: there is no such file, it is no regular one, or out of the folder.
    """
    try:
        real = path.resolve() if folder else path
        if folder and not real.is_relative_to(folder.resolve()):
            raise InputError(path, found="a path out of the folder", expected="one within")
        if not stat.S_ISREG(os.stat(real).st_mode):
            raise InputError(path, found=_kind(real), expected="a file")
        # It may be another by now: neither wait for a pipe's other end nor believe the first look.
        handle = os.open(
            real, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        )
        file = os.fdopen(handle, "rb")
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            file.close()
            raise InputError(path, found="no regular file", expected="a file")
    except (OSError, RuntimeError, ValueError) as error:
        found = getattr(error, "strerror", None) or error
        raise InputError(shown(path), found=found, expected="a file") from error
    return file


def _kind(path: Path) -> str:
    return "a folder" if path.is_dir() else "a pipe, a device or the like"


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
        with open_regular(inner, self.path) as file:
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
