"""Threads and memory of the native kernels, and PyTorch's threads beside them.

The kernels have threads of their own that sleep when there is nothing to do. PyTorch's are
OpenMP's: they spin after each operation and at each barrier, and take the processors from
everything else that runs, our kernels included. Code that mixes both therefore puts PyTorch on one
thread meanwhile.

A step makes and frees the same large tensors as the one before. The system takes freed blocks back
and hands them out zeroed, page by page: a fifth of a step with millions of Gaussians. So within
`reused` they stay here when their last tensor is gone (ours).
"""

import ctypes
import math
import os
from collections.abc import Generator
from contextlib import contextmanager
from functools import cache
from math import prod
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
import torch
from torch import Tensor

CGROUPS = Path("/sys/fs/cgroup")
_kept: list[int] = []
"""Threads of the kernels within each `one_torch_thread` that is entered."""
SMALLEST = 1 << 22
"""Bytes below which the allocator keeps blocks by itself."""
_free: list[Tensor] = []
"""Blocks that no tensor uses."""
_choosing = Lock()
_reusing: list[None] = []
"""One for each `reused` that is entered."""


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


def release_freed() -> None:
    """Give freed memory back to the system, where the C library can; nothing happens elsewhere.

    glibc keeps what was freed in blocks below 32 MiB: after a streamed SOG of 18 million splats was
    read as much as the splats themselves.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if os.name == "posix" else None
    if trim is not None:
        trim(0)


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


class _Loan:
    """A block while tensors use it: the base of their array, which lives as long as they do."""

    def __init__(self, block: Tensor, shape: tuple[int, ...]) -> None:
        self._block = block
        self.__array_interface__ = block[: prod(shape)].view(shape).numpy().__array_interface__

    def __del__(self) -> None:
        if _reusing:
            _free.append(self._block)


@contextmanager
def reused() -> Generator[None]:
    """Keep buffers within the `with` block, and give them back to the system after."""
    _reusing.append(None)
    try:
        yield
    finally:
        _reusing.pop()
        if not _reusing:
            _free.clear()


def empty_buffer(*shape: int) -> Tensor:
    """A float32 tensor on the CPU without values, as `torch.empty`."""
    count = prod(shape)
    if 4 * count < SMALLEST or not _reusing:
        return torch.empty(shape)
    block = _taken(count)
    if block is None:
        block = torch.empty(count + count // 8)
    loan: Any = _Loan(block, shape)
    return torch.from_numpy(np.asarray(loan))


def _taken(count: int) -> Tensor | None:
    """The smallest free block of at least `count` and at most 2 × `count` numbers, or None."""
    with _choosing:  # a page may show the training from another thread
        fitting = [i for i, block in enumerate(_free) if count <= len(block) <= 2 * count]
        if fitting:
            return _free.pop(min(fitting, key=lambda i: len(_free[i])))
        # What was just too small for this is of the same kind, and will be so again.
        _free[:] = [block for block in _free if not count / 2 < len(block) < count]
        return None


def empty_buffer_like(tensor: Tensor) -> Tensor:
    """A float32 tensor of the same shape on the CPU without values."""
    return empty_buffer(*tensor.shape)
