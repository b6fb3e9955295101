"""Tensors of a training that live on the device while steps run.

The host's tensors are the truth until a step takes them to the device, and again after `home`.
Between the two nothing on the host may read or write them.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gsynopsis.render.webgpu.device import Buffer, Gpu


class Resident:
    """Device copies of host tensors and gradients of some of them."""

    def __init__(self, gpu: Gpu) -> None:
        self.gpu = gpu
        # By identity; the tensor is kept, so that its number is not given to another one.
        self._held: dict[tuple[int, str], tuple[Tensor, Buffer]] = {}
        self._changed: set[tuple[int, str]] = set()
        self._grads: dict[int, Buffer] = {}
        self._moving: set[int] = set()

    def of(self, tensor: Tensor, *, changed: bool = False) -> Buffer:
        """A tensor's device copy, float32 or int32; `changed`: kernels write to it."""
        (buffer,) = self.derived(tensor, {"": _words})
        if changed:
            self._changed.add((id(tensor), ""))
        return buffer

    def derived(
        self, tensor: Tensor, words: Mapping[str, Callable[[Tensor], NDArray[Any]]]
    ) -> list[Buffer]:
        """Buffers made of a tensor, by name; made once while the tensor is the same one."""
        for name, make in words.items():
            if (id(tensor), name) not in self._held:
                array = make(tensor)
                held = tensor, self.gpu.upload(array, f"{array.size:,} numbers")
                self._held[id(tensor), name] = held
        return [self._held[id(tensor), name][1] for name in words]

    def grad(self, tensor: Tensor) -> Buffer:
        """The gradient of a tensor in this step, zeros before the first kernel adds to it."""
        key = id(tensor)
        self.of(tensor)
        if key not in self._grads:
            self._grads[key] = self.gpu.empty(tensor.numel(), f"{tensor.numel():,} gradients")
        self._moving.add(key)
        return self._grads[key]

    def take_grad(self, tensor: Tensor) -> Buffer | None:
        """The gradient that this step added up; None: it has none."""
        return self._grads[id(tensor)] if id(tensor) in self._moving else None

    def drop_grads(self) -> None:
        """Queue zeros for all gradients of this step."""
        for key in sorted(self._moving, key=list(self._grads).index):
            self.gpu.clear(self._grads[key])
        self._moving.clear()

    def home(self) -> None:
        """Give changed tensors their values on the device; forget all copies."""
        for key in self._changed:
            tensor, buffer = self._held[key]
            values = self.gpu.read(buffer, np.float32, tensor.numel()).copy()
            with torch.no_grad():
                tensor.copy_(torch.from_numpy(values).view(tensor.shape))
        self._held.clear()
        self._changed.clear()
        self._grads.clear()
        self._moving.clear()


def live_bits(mask: Tensor) -> NDArray[np.uint32]:
    """A word for each anchor with a bit for each of its up to 32 slots; [N, K] bool → [N]."""
    weights = np.left_shift(np.uint32(1), np.arange(mask.shape[1], dtype=np.uint32))
    return (mask.numpy() * weights).sum(axis=1, dtype=np.uint32)


def _words(tensor: Tensor) -> NDArray[Any]:
    array = tensor.detach().contiguous().numpy()
    return array if array.dtype == np.float32 else array.astype(np.int32)
