"""Head outputs of visible anchors to Gaussians: native on the CPU, plain PyTorch elsewhere.

Letters: V visible anchors of N, K slots, G rendered Gaussians.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn import functional

from gsynopsis._native import _core
from gsynopsis._native.runtime import empty_buffer, empty_buffer_like, thread_count
from gsynopsis.model.heads_kernel import fresh, gradient_of
from gsynopsis.render.base import Gaussians

SHAPES = ((3,), (4,), (3,), (), (3,))
"""A Gaussian's mean, quaternion, scale, opacity and colour."""


@dataclass(frozen=True)
class SlotTables:
    """Tensors of all anchors beside features.

    Attributes:
        positions: [N, 3], world units.
        log_scales: [N, 6], of the offsets and of the Gaussians.
        offsets: [N, K, 3], in units of the offset scales.
        live: [N, K] bool, slots that may be rendered.
        log_gain: [3], added to the logarithm of every Gaussian's scales.
    """

    positions: Tensor
    log_scales: Tensor
    offsets: Tensor
    live: Tensor
    log_gain: Tensor


@dataclass(frozen=True)
class Assembled:
    """The rendered slots as Gaussians, their flat slots row · K + slot [G], and tanh [V, K]."""

    gaussians: Gaussians
    slots: Tensor
    opacity: Tensor


def assemble(heads: tuple[Tensor, Tensor, Tensor], rows: Tensor, tables: SlotTables) -> Assembled:
    """Gaussians of the live slots whose opacity is positive (methods.md §1.1, §1.5).

    Args:
        heads: opacity [V, K], cov [V, 7K] and color [V, 3K] before their activations.
        rows: Visible anchors, int64 [V], strictly ascending.
        tables: What the anchors hold.
    """
    if tables.offsets.device.type != "cpu" or tables.offsets.dtype != torch.float32:
        return assemble_reference(heads, rows, tables)
    learnt = tables.log_scales, tables.offsets, tables.log_gain
    *gaussians, slots, opacity = _Assemble.apply(rows, tables, *heads, *learnt)
    return Assembled(Gaussians(*gaussians), slots, opacity)


def assemble_reference(
    heads: tuple[Tensor, Tensor, Tensor], rows: Tensor, tables: SlotTables
) -> Assembled:
    """`assemble` in plain PyTorch, any dtype and device: the oracle.

    The host waits once, for how many slots are drawn. Rows are read as in `heads_reference`.
    """
    slots = tables.offsets.shape[1]
    opacity = heads[0].tanh()
    drawn = (opacity > 0) & tables.live.index_select(0, rows)
    chosen = drawn.reshape(-1).nonzero()[:, 0]
    anchor = chosen // slots
    parents = rows.index_select(0, anchor)
    flat = parents * slots + chosen % slots
    cov = heads[1].reshape(-1, 7).index_select(0, chosen)
    color = heads[2].reshape(-1, 3).index_select(0, chosen).sigmoid()
    base = tables.log_scales.index_select(0, rows).exp().index_select(0, anchor)
    offset = tables.offsets.reshape(-1, 3).index_select(0, flat)
    means = tables.positions.index_select(0, parents) + offset * base[:, :3]
    scales = base[:, 3:] * cov[:, :3].sigmoid() * tables.log_gain.exp()
    quats = functional.normalize(cov[:, 3:], dim=1)
    shown = opacity.reshape(-1).index_select(0, chosen)
    return Assembled(Gaussians(means, quats, scales, shown, color), flat, opacity.detach())


class SlotsPass:
    """The native pass and what its gradients need; `assemble` with autograd left to the caller.

    Where a step has already given scales and offsets a gradient, the backward pass adds to it in
    place, as in `HeadsKernel`.
    """

    def __init__(
        self, heads: tuple[Tensor, Tensor, Tensor], rows: Tensor, tables: SlotTables
    ) -> None:
        """Nothing is computed yet; arguments as in `assemble`, on the CPU, float32."""
        self.tables = tables
        learnt = tables.log_scales, tables.offsets, tables.log_gain
        arrays = (rows, tables.live.view(torch.uint8), *heads, tables.positions, *learnt)
        self.arrays: Any = tuple(t.detach().contiguous().numpy() for t in arrays)
        self.shape = heads[0].shape

    def forward(self) -> tuple[Tensor, ...]:
        """Means, quaternions, scales, opacities, colours, flat slots, and tanh [V, K]."""
        self.activated = empty_buffer(*self.shape)
        self.starts = torch.empty(self.shape[0] + 1, dtype=torch.int64)
        threads, drawn = thread_count(), (self.activated.numpy(), self.starts.numpy())
        count = _core.count_drawn(self.arrays, *drawn, threads)
        out = tuple(empty_buffer(count, *shape) for shape in SHAPES)
        flat = torch.empty(count, dtype=torch.int64)
        made: Any = tuple(t.numpy() for t in out)
        _core.assemble(self.arrays, drawn, made, flat.numpy(), threads)
        return *out, flat, self.activated

    def backward(
        self, grads: Sequence[Tensor], needed: Sequence[bool]
    ) -> tuple[tuple[Tensor, ...], list[Tensor | None]]:
        """Gradients of the three heads, and those of log_scales, offsets and log_gain.

        Args:
            grads: Of means, quaternions, scales, opacities and colours.
            needed: Whether log_scales and offsets want theirs.

        Returns:
            Of what wants none it is None, and a leaf's own `grad` where it was added to.
        """
        t, (visible, slots) = self.tables, self.shape
        heads = tuple(empty_buffer(visible, slots * width) for width in (1, 7, 3))
        leaves = (t.log_scales, t.offsets)
        tables = [gradient_of(leaf, True, empty_buffer_like) for leaf in leaves]
        held = [grad is leaf.grad for grad, leaf in zip(tables, leaves, strict=True)]
        if any(held) and not all(held):  # one pass adds to both, or to none
            held, tables = [False], [torch.empty_like(leaf) for leaf in leaves]
        shares, gain = torch.empty(visible, 3), torch.empty_like(t.log_gain.detach())
        given: Any = tuple(g.contiguous().numpy() for g in grads[: len(SHAPES)])
        wanted: Any = tuple(g.numpy() for g in (*heads, *tables) if g is not None)
        drawn = (self.activated.numpy(), self.starts.numpy())
        rest: Any = (shares.numpy(), gain.numpy(), thread_count())
        _core.assemble_backward(self.arrays, drawn, given, wanted, *rest, add=all(held))
        kept = [grad if want else None for grad, want in zip(tables, needed, strict=True)]
        return heads, [*kept, gain]


class _Assemble(torch.autograd.Function):
    """Inputs: rows, tables and the heads, then the differentiable log_scales … log_gain."""

    @staticmethod
    def forward(ctx: Any, rows: Tensor, tables: SlotTables, *inputs: Tensor) -> tuple[Tensor, ...]:
        opacity, cov, color = inputs[:3]
        ctx.native = SlotsPass((opacity, cov, color), rows, tables)
        *out, flat, activated = ctx.native.forward()
        ctx.mark_non_differentiable(flat, activated)
        return *out, flat, activated

    @staticmethod
    @once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx: Any, *grads: Tensor
    ) -> tuple[Tensor | None, ...]:
        native: SlotsPass = ctx.native
        t, needs = native.tables, ctx.needs_input_grad
        heads, (sizes, offsets, gain) = native.backward(grads, needs[5:7])
        return None, None, *heads, fresh(sizes, t.log_scales), fresh(offsets, t.offsets), gain
