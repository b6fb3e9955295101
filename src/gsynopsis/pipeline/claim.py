"""One training at a time in a folder: a lock that its process holds, and what a killed one left."""

import errno
import fcntl
import os
import re
import socket
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from gsynopsis.errors import SettingError

LOCK_FILE = "training.lock"
UNLOCKABLE = {errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL}
"""What file systems say that have no locks; there a training goes without."""
LEFTOVER = re.compile(
    r"(?:checkpoint|full|run\.json)\.tmp"
    r"|\.(?:scene\.gsyn|scene|metrics|views|timelines?|contact|report|popping)\.(\d+)\.[a-z]+"
)
"""Drafts of files in a run's folder, see `checkpoint`, `writer` and `publish`; some name their
process."""


@contextmanager
def claimed(out: Path) -> Generator[None]:
    """Hold a run's folder for one `with` block, and clear it of drafts that a kill left behind.

    The system releases the lock however the process ends.

    Args:
        out: The folder, existing.

    Raises:
        SettingError: another process trains in it; the message names it and since when.
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
    for path in out.iterdir():
        match = LEFTOVER.fullmatch(path.name)
        if match and path.is_file() and not (match[1] and _runs(int(match[1]))):
            path.unlink(missing_ok=True)


def _locked(path: Path, out: Path) -> int:
    """A descriptor of the lock file, locked."""
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
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


def _same_file(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except FileNotFoundError:
        return False


def _runs(process: int) -> bool:
    """Whether there is such a process besides this one."""
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return process != os.getpid()
