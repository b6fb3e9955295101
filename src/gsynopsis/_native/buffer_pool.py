"""Memory that large results of native passes use again and again (ours).

A step makes and frees the same large tensors as the one before. The system takes freed blocks back
and hands them out zeroed, page by page: a fifth of a step with millions of Gaussians. So within
`reused` they stay here when their last tensor is gone.
"""

from collections.abc import Generator
from contextlib import contextmanager
from math import prod
from threading import Lock
from typing import Any

import numpy as np
import torch
from torch import Tensor

SMALLEST = 1 << 22
"""Bytes below which the allocator keeps blocks by itself."""
_free: list[Tensor] = []
"""Blocks that no tensor uses."""
_choosing = Lock()
_entered: list[None] = []
"""One for each `reused` that is entered."""


class _Loan:
    """A block while tensors use it: the base of their array, which lives as long as they do."""

    def __init__(self, block: Tensor, shape: tuple[int, ...]) -> None:
        self._block = block
        self.__array_interface__ = block[: prod(shape)].view(shape).numpy().__array_interface__

    def __del__(self) -> None:
        if _entered:
            _free.append(self._block)


@contextmanager
def reused() -> Generator[None]:
    """Keep what `empty` hands out within the `with` block, and give it back to the system after."""
    _entered.append(None)
    try:
        yield
    finally:
        _entered.pop()
        if not _entered:
            _free.clear()


def empty(*shape: int) -> Tensor:
    """A float32 tensor on the CPU without values, as `torch.empty`."""
    count = prod(shape)
    if 4 * count < SMALLEST or not _entered:
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


def empty_like(tensor: Tensor) -> Tensor:
    """A float32 tensor of the same shape on the CPU without values."""
    return empty(*tensor.shape)
