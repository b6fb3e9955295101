"""A training that stays below a limit of memory: what is more is in a file of its run."""

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import torch

from gsynopsis._native.spill import begin, is_loaded
from gsynopsis.errors import SettingError, SpaceError

GIB = 2**30
MEMORY_MOST = 1_000_000
"""GiB: more than any machine has, and few enough to count in bytes."""


def spills(device: torch.device) -> bool:
    """Whether memory of trainings on a device spills, so that a limit changes nothing of them."""
    return device.type == "cpu" and is_loaded()


def limit_bytes(max_memory: float) -> int:
    """A limit of memory, GiB, in bytes.

    Raises:
        SettingError: it is no size.
    """
    if not 0 < max_memory <= MEMORY_MOST:
        expected = f"GiB above 0, at most {MEMORY_MOST:,}"
        raise SettingError("--max-memory", found=max_memory, expected=expected)
    return round(max_memory * GIB)


def spilled_limit(device: torch.device, max_memory: float | None) -> int | None:
    """Bytes that stay in memory where the rest spills; None where nothing does.

    Raises:
        SettingError: the limit is no size.
    """
    if max_memory is None or not spills(device):
        return None
    return limit_bytes(max_memory)


def begin_spilling(out: Path, device: torch.device, max_memory: float | None) -> None:
    """Stay below a limit before `out` is made: a scene's points can be large by themselves.

    Args:
        out: Folder of the run; where it is missing, the file is on the disk that it will be on.
        device: That trains.
        max_memory: As in `spilling`.

    Raises:
        SettingError: the limit is no size.
        SpaceError: no file can be made there.
    """
    limit = spilled_limit(device, max_memory)
    if limit is not None:
        folder = next(f for f in (out.absolute(), *out.absolute().parents) if f.is_dir())
        begin(folder, limit)


@contextmanager
def spilling(folder: Path, device: torch.device, max_memory: float | None) -> Generator[None]:
    """Within, this process stays below a limit, GiB, where there is one and memory spills.

    Args:
        folder: Where the file is; it has no name, and is gone with the process.
        device: That trains.
        max_memory: The limit.

    Raises:
        SpaceError: the folder's disk has no room for what exceeds the limit.
    """
    if max_memory is None or not spills(device):
        yield
        return
    begin_spilling(folder, device, max_memory)
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        if isinstance(error, RuntimeError) and "can't allocate memory" not in str(error):
            raise
        advice = "free some room: the last checkpoint is kept"
        expected = f"room for memory beyond the {max_memory:g} GiB of --max-memory"
        raise SpaceError(folder, found="a full disk", expected=expected, advice=advice) from error
