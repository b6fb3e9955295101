"""Regular files, opened: whatever else a name leads to (a pipe, a device, a folder) is refused.

A scene, a list or a picture names other files; to open a pipe of that name would wait for ever, and
a device has no end.
"""

import os
import stat
from io import BufferedReader
from pathlib import Path

from gsynopsis.errors import InputError

KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}
AT_ONCE = getattr(os, "O_NONBLOCK", 0)
"""Does not wait for a writer where a pipe took the file's place meanwhile."""


def open_regular(
    path: Path | str, error: type[InputError] = InputError, expected: str = "a readable file"
) -> BufferedReader:
    """A regular file, or a link to one, open for reading.

    Args:
        path: The file.
        error: Raised where it cannot be opened.
        expected: What should lie there, for the message.

    Raises:
        InputError: There is none, it is something else than a regular file, or cannot be read.
    """
    try:
        # Before it is opened, for a device may act on that; then again, of what was opened.
        _check_kind(os.stat(path).st_mode, path, error, expected)
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_BINARY", 0) | AT_ONCE)
        file = os.fdopen(handle, "rb")
    except OSError as cause:
        reason = cause.strerror or cause
        raise error(path, found=reason, expected=expected) from cause
    except ValueError as cause:  # a name with a NUL
        raise error(ascii(str(path)), found=str(cause), expected=expected) from cause
    try:
        _check_kind(os.fstat(handle).st_mode, path, error, expected)
    except InputError:
        file.close()
        raise
    return file


def read_regular(
    path: Path | str,
    error: type[InputError] = InputError,
    expected: str = "a readable file",
    most: int | None = None,
) -> bytes:
    """The bytes of a regular file.

    Args:
        path: The file.
        error: Raised where it cannot be read.
        expected: What should lie there, for the message.
        most: Bytes that it may have; None: any number.

    Raises:
        InputError: See `open_regular`; or the file is larger.
    """
    with open_regular(path, error, expected) as file:
        size = os.fstat(file.fileno()).st_size
        if most is not None and size > most:
            raise error(path, found=f"{size:,} bytes", expected=f"at most {most:,}")
        try:
            return file.read()
        except OSError as cause:
            raise error(path, found=cause.strerror or cause, expected=expected) from cause


def _check_kind(mode: int, path: Path | str, error: type[InputError], expected: str) -> None:
    if not stat.S_ISREG(mode):
        kind = KINDS.get(stat.S_IFMT(mode), "no regular file")
        raise error(path, found=kind, expected=expected)
