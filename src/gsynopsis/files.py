"""Files on disk: written beside and renamed, so that they are whole; opened only if regular."""

import errno
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path

from gsynopsis.errors import InputError, SpaceError

DRAFT = re.compile(r"\.(.*)\.(\d+)\.[a-z0-9_]{8}\.draft", re.DOTALL)
"""Folders of drafts: beginning of the file's name, and the process that makes it."""
NAMED = 40
"""Characters of a file's name in that of its draft's folder: names have at most 255 bytes."""
FULL_DISK = (errno.ENOSPC, errno.EDQUOT)
_making = set[str]()
"""Folders of drafts that this process fills now."""
KINDS = (
    (stat.S_ISLNK, "a link"),
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
)


@contextmanager
def published(path: Path) -> Generator[Path]:
    """A name to write to; when the block ends well the file takes the name `path`.

    A failure, also Ctrl-C, leaves the older file as it was and nothing beside it. What a killed
    process left of the same file is removed.

    Args:
        path: Where the file goes; its folder is made if it is missing, a link is replaced.

    Yields:
        A name that no other process uses, with the same suffix.

    Raises:
        SpaceError: the disk is full.
        InputError: it is the name of a folder, or cannot be written.
    """
    if path.is_dir():
        raise InputError(path, found="a folder", expected="the name of a file")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        clear_drafts(path.parent, path.name)
        with drafted(path) as draft:
            yield draft
    except OSError as error:
        raise write_error(path, error) from error


def publish(path: Path, content: bytes | str) -> Path:
    """Write a file so that a reader, or a crash, never sees half of it; text as UTF-8."""
    with published(path) as draft:
        draft.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@contextmanager
def drafted(path: Path, *, durable: bool = True) -> Generator[Path]:
    """As `published` in a folder that is there, without looking at what others left.

    Args:
        path: Where the file goes.
        durable: It survives a power cut; False for what can be made again.

    Raises:
        OSError: it cannot be written.
    """
    # A new folder has nothing in it that somebody put there, nor what a library writes beside.
    prefix = f".{path.name[:NAMED]}.{os.getpid()}."
    folder = Path(tempfile.mkdtemp(".draft", prefix, path.parent))
    _making.add(folder.name)
    try:
        draft = folder / path.name
        yield draft
        if durable:
            with draft.open("rb") as file:
                os.fsync(file.fileno())
        os.replace(draft, path)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        _making.discard(folder.name)


def clear_drafts(folder: Path, name: str | None = None) -> None:
    """Remove what processes left that were killed while they wrote.

    Args:
        folder: In which they wrote.
        name: Of their file; None: of any.
    """
    for entry in os.scandir(folder):
        match = DRAFT.fullmatch(entry.name)
        if match is None or (name is not None and match[1] != name[:NAMED]):
            continue
        # A process of this number may be this one, and what it left another's: numbers come again.
        if entry.name in _making:
            continue
        if entry.is_dir(follow_symlinks=False) and not is_running(int(match[2])):
            shutil.rmtree(entry.path, ignore_errors=True)


def is_running(process: int) -> bool:
    """True if there is such a process besides this one."""
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return process != os.getpid()


def write_error(path: Path, error: OSError) -> InputError:
    """Error for a file that cannot be written."""
    if error.errno in FULL_DISK:
        advice = "free some space or choose another folder"
        return SpaceError(path, "disk", found=error.strerror, expected="room for it", advice=advice)
    reason = error.strerror or error
    return InputError(path, found=reason, expected="a writable path")


def open_regular(
    path: Path | str,
    error: type[InputError] = InputError,
    expected: str = "a regular file",
    *,
    links: bool = True,
) -> BufferedReader:
    """A file at an untrusted path, open for reading.

    Args:
        path: Path of the file.
        error: Raised if it cannot be opened.
        expected: Kind of file that should lie there, for the message.
        links: The name may be a link to it.

    Raises:
        InputError: there is none, it may not be read, or it is not a regular file but, say, a pipe,
            whose reader may wait for ever.
    """
    # Without a wait for whoever would write to a pipe.
    flags = os.O_RDONLY | getattr(os, "O_BINARY", 0) | getattr(os, "O_NONBLOCK", 0)
    flags |= 0 if links else getattr(os, "O_NOFOLLOW", 0)
    try:
        # Before it is opened, for a device may act on that; then again, of what was opened.
        _check_kind(os.stat(path, follow_symlinks=links).st_mode, path, error, expected)
        handle = os.open(path, flags | getattr(os, "O_CLOEXEC", 0))
    except OSError as cause:
        raise error(path, found=cause.strerror or cause, expected=expected) from cause
    except ValueError as cause:  # a NUL, or half a surrogate pair
        raise error(ascii(str(path)), found=cause, expected=expected) from cause
    try:
        _check_kind(os.fstat(handle).st_mode, path, error, expected)
    except BaseException:
        os.close(handle)
        raise
    return os.fdopen(handle, "rb")


def read_regular(
    path: Path | str,
    most: int | None = None,
    error: type[InputError] = InputError,
    expected: str = "a regular file",
    *,
    links: bool = True,
) -> bytes:
    """The bytes of a file, see `open_regular`; of one with more than `most`, none.

    Raises:
        InputError: as `open_regular`, or it is too long.
    """
    with open_regular(path, error, expected, links=links) as file:
        size = os.fstat(file.fileno()).st_size
        if most is not None and size > most:
            raise error(path, found=f"{size:,} bytes", expected=f"at most {most:,}")
        try:
            return file.read() if most is None else file.read(most)
        except OSError as cause:
            raise error(path, found=cause.strerror or cause, expected=expected) from cause


def inner_folder(folder: Path, name: str) -> Path:
    """A folder in another one to write to, made if it is missing.

    Raises:
        InputError: a link is there, which leads out of it.
        OSError: it cannot be made.
    """
    path = folder / name
    refuse_link(path)
    path.mkdir(parents=True, exist_ok=True)
    return path


def refuse_link(path: Path) -> None:
    """Nothing is written into a folder that is one.

    Raises:
        InputError: it is a link.
    """
    if path.is_symlink():
        raise InputError(path, found="a link", expected="a folder", advice="remove it")


def _check_kind(mode: int, path: Path | str, error: type[InputError], expected: str) -> None:
    if not stat.S_ISREG(mode):
        found = next((name for test, name in KINDS if test(mode)), "a device")
        raise error(path, found=found, expected=expected)
