"""One training at a time in a folder: a lock that its process holds, and what a killed one left."""

import errno
import fcntl
import os
import re
import socket
import stat
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from gsynopsis import files
from gsynopsis.errors import InputError, SettingError

LOCK_FILE = "training.lock"
NO_FILE = {errno.ELOOP, errno.EMLINK, errno.EISDIR, errno.ENXIO}
"""Errors of systems for a link, a folder or a device where a file should be."""
UNLOCKABLE = {errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL}
"""Errors of file systems without locks; there a training goes without."""
LEFTOVER = re.compile(
    r"(?:checkpoint|full|run\.json)\.tmp|\.tmp[A-Za-z0-9]{6}"
    r"|\.(?:scene\.gsyn|scene|metrics|views|timelines?|contact|report|popping)\.(\d+)\.[a-z]+"
)
"""Drafts that older versions left in a run's folder; some name their process. Those of today are
cleared by `files`."""


@contextmanager
def run_lock(out: Path) -> Generator[None]:
    """Hold a run's folder for one `with` block, and clear it of drafts that a kill left behind.

    The system releases the lock however the process ends.

    Args:
        out: The folder, existing.

    Raises:
        SettingError: another process trains in it; the message names it and since when.
        InputError: the lock is a link, or something else than a file of its own.
    """
    path = out / LOCK_FILE
    handle = _locked(path, out)
    try:
        os.ftruncate(handle, 0)
        begun = time.strftime("%Y-%m-%d %H:%M:%S")
        os.write(handle, f"process {os.getpid()} on {socket.gethostname()} since {begun}".encode())
        clear_drafts(out)
        yield
    finally:
        path.unlink(missing_ok=True)
        os.close(handle)


def clear_drafts(out: Path) -> None:
    """Remove half written files whose process is gone."""
    files.clear_drafts(out)
    for path in out.iterdir():
        match = LEFTOVER.fullmatch(path.name)
        if match and path.is_file() and not (match[1] and files.is_running(int(match[1]))):
            path.unlink(missing_ok=True)


def _locked(path: Path, out: Path) -> int:
    """A descriptor of the lock file, locked."""
    while True:
        handle = _opened(path)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            holder = os.read(handle, 200).decode(errors="replace")
            os.close(handle)
            raise SettingError(
                out,
                found=f"a training in it: {holder or 'one that just begins'}",
                expected="a folder of its own",
                advice="wait until that one ends, stop it, or choose another --out",
            ) from error
        except OSError as error:
            if error.errno not in UNLOCKABLE:
                os.close(handle)
                raise
        # Whoever held it before may have removed the file in between: then this is no lock.
        if _same_file(handle, path):
            return handle
        os.close(handle)


def _opened(path: Path) -> int:
    """A descriptor of the lock file, which is new or a file that has no other name.

    A link would make a file elsewhere the lock, which is emptied and written.
    """
    try:
        # Without a wait: a pipe of this name would have one.
        flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        handle = os.open(path, flags, 0o644)
    except OSError as error:
        if error.errno not in NO_FILE:
            raise
        raise _no_lock(path) from error
    now = os.fstat(handle)
    if not stat.S_ISREG(now.st_mode) or now.st_nlink > 1:
        os.close(handle)
        raise _no_lock(path)
    return handle


def _no_lock(path: Path) -> InputError:
    found, expected = "a link, or no regular file", "the lock of a training, or nothing"
    return InputError(path, found=found, expected=expected, advice="remove it")


def _same_file(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), path.lstat())
    except FileNotFoundError:
        return False
