"""Hash grids by level, their contraction, and the codebook with a straight-through choice."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from gsynopsis._native import _core
from gsynopsis._native.runtime import thread_count
from gsynopsis.records import Frame
from gsynopsis.render.base import sent

PRIMES = (1, 2654435761, 805459861)
"""Multipliers of the spatial hash (instant-ngp)."""


@dataclass(frozen=True)
class GridLayout:
    """Place of each grid in the one flat table.

    Attributes:
        resolutions: Vertices per axis of each grid, ascending.
        sizes: Rows of each grid.
        offsets: First row of each grid.
        features: Values per row.
    """

    resolutions: tuple[int, ...]
    sizes: tuple[int, ...]
    offsets: tuple[int, ...]
    features: int

    @property
    def rows(self) -> int:
        """Rows of the flat table."""
        return sum(self.sizes)


@lru_cache(maxsize=32)
def coarsest_grids(layout: GridLayout, count: int) -> GridLayout:
    """The layout of the coarsest `count` grids."""
    kept = (layout.resolutions[:count], layout.sizes[:count], layout.offsets[:count])
    return GridLayout(*kept, layout.features)


def grid_layout(resolutions: Sequence[int], table_log2: int, features: int = 4) -> GridLayout:
    """Rows per grid: min(T, r³) rounded up to a multiple of 8 (methods.md §1.3)."""
    sizes = tuple(min(1 << table_log2, -(-(r**3) // 8) * 8) for r in resolutions)
    return layout_of(resolutions, sizes, features)


def layout_of(resolutions: Sequence[int], sizes: Sequence[int], features: int) -> GridLayout:
    """The layout of grids whose sizes are known."""
    offsets = tuple(int(o) for o in np.cumsum([0, *sizes[:-1]])) if sizes else ()
    return GridLayout(tuple(resolutions), tuple(sizes), offsets, features)


def grid_coordinates(positions: Tensor, frame: Frame) -> Tensor:
    """World positions [N, 3] to grid coordinates in [0, 1], [N, 3] (methods.md §1.3).

    With contraction the ball |y| ≤ 1 spans half of the unit cube and all of space fits; without it
    the box centre ± radius spans the cube and positions outside clamp to its border.
    """
    center = torch.as_tensor(frame.center, dtype=positions.dtype, device=positions.device)
    y = (positions - center) / frame.radius
    if not frame.contract:
        return ((y + 1) / 2).clamp(0, 1)
    norm = y.norm(dim=1, keepdim=True)
    far = (2 - 1 / norm.clamp(min=1)) * y / norm.clamp(min=1)
    return ((torch.where(norm > 1, far, y) + 2) / 4).clamp(0, 1)


@lru_cache(maxsize=8)
def _grid_constants(layout: GridLayout, device: torch.device) -> tuple[Tensor, ...]:
    """Int64: factors of a vertex's coordinates [L, 3, 1]; resolutions, rows and offsets [L, 1, 1].

    Factors are those of dense rows or of the hash.
    """
    pairs = list(zip(layout.resolutions, layout.sizes, strict=True))
    factors = [(1, r, r * r) if r**3 <= size else PRIMES for r, size in pairs]
    columns = (layout.resolutions, layout.sizes, layout.offsets)
    made = [torch.tensor(factors)[:, :, None], *(torch.tensor(c)[:, None, None] for c in columns)]
    return tuple(sent(tensor, device) for tensor in made)


def all_corners(u: Tensor, layout: GridLayout) -> tuple[Tensor, Tensor]:
    """Rows of the flat table, int32, and trilinear weights of the corners of cells around points.

    Of points [V, 3] in [0, 1] and all grids at once, [V, L, 8]. A grid is dense where all its
    vertices have rows, else hashed.
    """
    factors, resolutions, sizes, offsets = _grid_constants(layout, u.device)
    top = resolutions[..., 0] - 1  # [L, 1]
    p = u[:, None] * top  # [V, L, 3]
    cell = torch.minimum(p.floor().clamp(min=0), (top - 1).clamp(min=0).to(p.dtype))
    frac = p - cell
    low = cell.long()
    vertex = torch.stack([low, torch.minimum(low + 1, top)], dim=3)  # [V, L, 3, 2]
    x, y, z = (vertex * factors).unbind(dim=2)  # [V, L, 2] each
    x, y, z = x[:, :, None, None], y[:, :, None, :, None], z[:, :, :, None, None]
    dense = (factors[:, 1] == resolutions[..., 0])[:, :, None, None]  # [L, 1, 1, 1]
    # A dense row is below its grid's size, so the remainder leaves it as it is.
    mixed = torch.where(dense, x + y + z, (x ^ y ^ z) & 0xFFFFFFFF).flatten(2)  # [V, L, 8]
    rows = (mixed % sizes[..., 0] + offsets[..., 0]).int()
    wx, wy, wz = torch.stack([1 - frac, frac], dim=3).unbind(dim=2)
    weights = wx[:, :, None, None] * wy[:, :, None, :, None] * wz[:, :, :, None, None]
    return rows, weights.flatten(2)


class _IndexedGrids(torch.autograd.Function):
    """All grids in one gather; the backward pass is one `index_add_`.

    Autograd would write a gradient of the whole table for each grid, and sort millions of rows.
    """

    @staticmethod
    def forward(ctx: Any, u: Tensor, table: Tensor, layout: GridLayout) -> Tensor:
        rows, weights = all_corners(u, layout)
        weights = weights.to(table.dtype)
        ctx.save_for_backward(rows, weights)
        ctx.shape = table.shape
        read = table.index_select(0, rows.flatten()).view(*rows.shape, table.shape[1])
        return (read * weights[..., None]).sum(dim=2).flatten(1)

    @staticmethod
    @once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx: Any, grad: Tensor
    ) -> tuple[None, Tensor, None]:
        rows, weights = ctx.saved_tensors
        shares = grad.view(*rows.shape[:2], 1, ctx.shape[1]) * weights[..., None]
        table = grad.new_zeros(ctx.shape)
        return None, table.index_add_(0, rows.flatten(), shares.view(-1, ctx.shape[1])), None


def grid_features_indexed(u: Tensor, table: Tensor, layout: GridLayout) -> Tensor:
    """`grid_features` in plain PyTorch, any dtype and device."""
    return _IndexedGrids.apply(u, table, layout)  # type: ignore[no-any-return]


class _GridFunction(torch.autograd.Function):
    """The native gather; its backward scatters into a zeroed table, one thread a grid."""

    @staticmethod
    def forward(ctx: Any, u: Tensor, table: Tensor, layout: GridLayout) -> Tensor:
        u = u.contiguous()
        ctx.save_for_backward(u)
        ctx.layout, ctx.shape = layout, table.shape
        out = torch.empty(len(u), len(layout.sizes) * layout.features)
        _core.hashgrid_forward(
            u.numpy(),
            table.detach().contiguous().numpy(),
            *level_arrays(layout),
            out.numpy(),
            thread_count(),
        )
        return out

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[None, Tensor, None]:
        (u,) = ctx.saved_tensors
        table, layout = torch.zeros(ctx.shape), ctx.layout
        _core.hashgrid_backward(
            u.numpy(),
            grads[0].contiguous().numpy(),
            *level_arrays(layout),
            table.numpy(),
            thread_count(),
        )
        return None, table, None


@lru_cache(maxsize=32)
def level_arrays(
    layout: GridLayout,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Resolutions, first rows and sizes of the grids, as the native kernels take them."""
    resolutions, offsets, sizes = (
        np.array(values, dtype=np.int64)
        for values in (layout.resolutions, layout.offsets, layout.sizes)
    )
    return resolutions, offsets, sizes


def grid_features(u: Tensor, table: Tensor, layout: GridLayout) -> Tensor:
    """Features of the grids of `layout` at u [V, 3] in [0, 1], trilinear, [V, L·F].

    Native on the CPU in float32, plain PyTorch elsewhere; differentiable in `table` only.
    """
    if not layout.sizes:
        return u.new_zeros(len(u), 0)
    if u.device.type == "cpu" and u.dtype == torch.float32:
        return _GridFunction.apply(u, table, layout)  # type: ignore[no-any-return]
    return grid_features_indexed(u, table, layout)


class StraightThrough(torch.autograd.Function):
    """Forward: the codebook row of the largest logit. Backward: as if softmax had mixed rows.

    With g the gradient of the output, u = C·g and w = softmax(v): dv = w ⊙ (u − ⟨w, u⟩) and dC
    adds g to the chosen rows only (methods.md §1.4). No one-hot is built, no softmax kept.
    """

    @staticmethod
    def forward(ctx: Any, logits: Tensor, codebook: Tensor) -> Tensor:
        """Logits [V, C], codebook [C, D] → [V, D]."""
        index = logits.argmax(dim=1)
        ctx.save_for_backward(logits, codebook, index)
        return codebook[index]

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, Tensor]:
        """Gradients of logits and codebook, see the class."""
        (grad,) = grads
        logits, codebook, index = ctx.saved_tensors
        w = logits.softmax(dim=1)
        wu = w * (grad @ codebook.T)
        grad_logits = wu - w * wu.sum(dim=1, keepdim=True)
        return grad_logits, torch.zeros_like(codebook).index_add_(0, index, grad)
