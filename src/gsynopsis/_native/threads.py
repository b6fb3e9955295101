"""Thread counts of the native kernels, and of PyTorch beside them.

The kernels have threads of their own that sleep when there is nothing to do. PyTorch's are
OpenMP's: they spin after each operation and at each barrier, and take the processors from
everything else that runs, our kernels included. Code that mixes both therefore puts PyTorch on one
thread meanwhile.
"""

import math
import os
from collections.abc import Generator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import torch

CGROUPS = Path("/sys/fs/cgroup")
_kept: list[int] = []
"""Threads of the kernels within each `one_torch_thread` that is entered."""


def thread_count() -> int:
    """Threads of a native kernel: PyTorch's number, limited to the CPU quota.

    `OMP_NUM_THREADS` or `torch.set_num_threads` choose it; the former even above the quota.
    """
    if _kept:
        return _kept[-1]
    wanted, quota = torch.get_num_threads(), cpu_quota()
    if quota is None or "OMP_NUM_THREADS" in os.environ:
        return wanted
    return min(wanted, max(1, math.ceil(quota)))


@contextmanager
def one_torch_thread() -> Generator[None]:
    """PyTorch works on one thread within the `with` block; native kernels keep their number."""
    before = torch.get_num_threads()
    _kept.append(thread_count())
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
        _kept.pop()


@cache
def cpu_quota(groups: Path = Path("/proc/self/cgroup"), root: Path = CGROUPS) -> float | None:
    """Processors' worth of time that the container grants this process; None if all there is.

    Args:
        groups: The control groups of the process, as Linux lists them; other systems have none.
        root: Where they are mounted.
    """
    try:
        lines = groups.read_text().splitlines()
    except OSError:
        return None
    found: list[float] = []
    for line in lines:
        _, controllers, path = [*line.split(":", 2), "", ""][:3]
        if controllers and "cpu" not in controllers.split(","):
            continue
        # A container may see its group at the top, whatever its path on the host.
        folder = root / controllers / path.lstrip("/")
        while folder.is_relative_to(root):
            found += _quota(folder)
            folder = folder.parent
    return min(found, default=None)


def _quota(folder: Path) -> list[float]:
    """CPU quotas of a control group: version 2 has one file, version 1 two; empty: no limit."""
    try:
        if (folder / "cpu.max").is_file():
            quota, period = (folder / "cpu.max").read_text().split()
        else:
            quota, period = (
                (folder / f"cpu.cfs_{name}_us").read_text().strip() for name in ("quota", "period")
            )
        share = float(quota) / float(period)
    except (OSError, ValueError, ZeroDivisionError):  # `max`, or no such controller here
        return []
    return [share] if share > 0 else []
