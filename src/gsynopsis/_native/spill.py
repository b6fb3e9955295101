"""Memory that spills to disk: a process that stays below a limit and computes the same (ours).

A library that is loaded before all others takes the place of `malloc`. From `begin` on, large
blocks of memory, whoever asks for them, are in a file that is mapped, and pages go back to the
system where the process holds too many. It writes them to the file when it needs the room, and
reads them again when they are touched. Where a block is does not change what is computed.
"""

import ctypes
import os
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from gsynopsis import _native
from gsynopsis.errors import SpaceError

LIBRARY = "libspill.so"
SMALLEST = 1 << 20
"""Blocks below this many bytes stay where they are."""
PRELOAD, RESTARTED = "LD_PRELOAD", "GSYNOPSIS_RESTARTED"


def library() -> Path | None:
    """The library; None on systems that it was not built for, or where no list could name it."""
    paths = (Path(folder) / LIBRARY for folder in _native.__path__)
    return next((p for p in paths if p.is_file() and not set(" :") & set(str(p))), None)


def is_loaded() -> bool:
    """Whether this process was started with the library."""
    return sys.platform == "linux" and hasattr(_process(), "spill_begin")


def begin(folder: Path, limit: int) -> None:
    """Keep this process below `limit` bytes from now on; called again, it sets another limit.

    Args:
        folder: Where the file is; it has no name, and is gone with the process.
        limit: Bytes in memory, of all kinds. What is less than 1 MiB at a time is not spilled.

    Raises:
        SpaceError: no file can be made there.
    """
    code = _process().spill_begin(os.fsencode(folder), limit, SMALLEST)
    if code:
        raise SpaceError(folder, "memory", found=os.strerror(code), expected="a file to spill to")


def held() -> int:
    """Bytes of memory that are in the file; 0 without one."""
    return _process().spill_held() if is_loaded() else 0


def restart() -> None:
    """Begin this program again with the library, unless it is loaded or there is none."""
    if is_loaded():
        # Not for children, which may ask for it themselves.
        _set_preload([path for path in _preloaded() if not path.endswith(LIBRARY)])
        os.environ.pop(RESTARTED, None)
        return
    path = library()
    if path is None or RESTARTED in os.environ:
        return
    _set_preload([str(path), *_preloaded()])
    os.environ[RESTARTED] = "1"
    os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])


@contextmanager
def for_children() -> Generator[None]:
    """Processes that are started within have the library where this one has it."""
    before, path = _preloaded(), library()
    if is_loaded() and path is not None:
        _set_preload([str(path), *before])
    try:
        yield
    finally:
        _set_preload(before)


def _preloaded() -> list[str]:
    return [path for path in os.environ.get(PRELOAD, "").split(":") if path]


def _set_preload(paths: list[str]) -> None:
    if paths:
        os.environ[PRELOAD] = ":".join(paths)
    else:
        os.environ.pop(PRELOAD, None)


def _process() -> ctypes.CDLL:
    own = ctypes.CDLL(None)
    if hasattr(own, "spill_begin"):
        own.spill_begin.argtypes = [ctypes.c_char_p, ctypes.c_size_t, ctypes.c_size_t]
        own.spill_held.restype = ctypes.c_size_t
    return own
