"""Tensors of rows in files that are mapped into memory: what no view reads stays on disk."""

import mmap
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from weakref import WeakSet

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gsynopsis.errors import SpaceError

CHUNK = 1 << 14
"""Rows that a pass over all of them moves before it may give pages back."""
PAGE = mmap.PAGESIZE


class MappedRows:
    """Files of a folder without names: they are gone when nobody holds their tensors any more.

    Attributes:
        budget: Bytes of pages that may be in use before all are given back.
    """

    def __init__(self, folder: Path, budget: int) -> None:
        """No file yet; the folder exists."""
        self.folder, self.budget = folder, budget
        self._maps: WeakSet[Any] = WeakSet()
        self._touched = 0

    def zeros(self, shape: Sequence[int]) -> Tensor:
        """A float32 tensor of zeros; only what is written takes room on disk.

        Raises:
            SpaceError: the folder's disk cannot hold it.
        """
        size = 4 * int(np.prod(shape))
        if not size:
            return torch.zeros(*shape)
        try:
            with tempfile.TemporaryFile(dir=self.folder) as handle:
                handle.truncate(size)
                mapped = mmap.mmap(handle.fileno(), size)
        except OSError as error:
            raise SpaceError(
                self.folder, "rows", found=error, expected=f"{size} bytes for them"
            ) from error
        self._maps.add(mapped)
        return torch.frombuffer(mapped, dtype=torch.float32).view(*shape)

    def copied(
        self, values: Tensor, rows: Tensor | None = None, new: Tensor | None = None
    ) -> Tensor:
        """Rows of a tensor [N, …], all if there are none given, and new ones after them."""
        kept = len(values) if rows is None else len(rows)
        more = 0 if new is None else len(new)
        made = self.zeros((kept + more, *values.shape[1:]))
        for start in range(0, kept, CHUNK):
            part = slice(start, min(start + CHUNK, kept))
            made[part] = values[part if rows is None else rows[part]]
            self.touched(2 * 4 * made[part].numel())
        if new is not None:
            made[kept:] = new
        return made

    def read(self, rows: NDArray[np.int64], widths: Sequence[int]) -> None:
        """Count in the pages of these ascending rows, of tensors so many floats wide."""
        for width in widths:
            first = rows * (4 * width) // PAGE
            last = (rows * (4 * width) + 4 * width - 1) // PAGE
            fresh = np.maximum(first[1:], last[:-1] + 1)
            pages = (last[1:] - fresh + 1).clip(0).sum() + (last[:1] - first[:1] + 1).sum()
            self.touched(int(pages) * PAGE)

    def touched(self, size: int) -> None:
        """Count bytes of pages in use; where they are too many, all go back to the system.

        They stay in its cache as long as it has room, so that reading them again costs little.
        """
        self._touched += size
        if self._touched > self.budget:
            for mapped in list(self._maps):
                mapped.madvise(mmap.MADV_DONTNEED)
            self._touched = 0
