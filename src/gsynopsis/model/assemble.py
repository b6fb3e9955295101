"""Head outputs of visible anchors to Gaussians: native on the CPU, plain PyTorch elsewhere.

Letters: V visible anchors of N, K slots, G rendered Gaussians.
"""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn import functional

from gsynopsis._native import _core
from gsynopsis._native.threads import thread_count
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
    *gaussians, slots, opacity = _Assemble.apply(
        rows,
        tables.live,
        tables.positions,
        *(t.contiguous() for t in heads),
        tables.log_scales,
        tables.offsets,
        tables.log_gain,
    )
    return Assembled(Gaussians(*gaussians), slots, opacity)


def assemble_reference(
    heads: tuple[Tensor, Tensor, Tensor], rows: Tensor, tables: SlotTables
) -> Assembled:
    """`assemble` in plain PyTorch, any dtype and device: the oracle."""
    slots = tables.offsets.shape[1]
    opacity = heads[0].tanh()
    drawn = (opacity > 0) & tables.live[rows]
    chosen = drawn.reshape(-1).nonzero()[:, 0]
    anchor = chosen // slots
    cov = heads[1].reshape(-1, 7)[chosen]
    color = heads[2].reshape(-1, 3)[chosen].sigmoid()
    base = tables.log_scales[rows].exp()[anchor]
    offset = tables.offsets[rows].reshape(-1, 3)[chosen]
    means = tables.positions[rows][anchor] + offset * base[:, :3]
    scales = base[:, 3:] * cov[:, :3].sigmoid() * tables.log_gain.exp()
    quats = functional.normalize(cov[:, 3:], dim=1)
    gaussians = Gaussians(means, quats, scales, opacity.reshape(-1)[chosen], color)
    return Assembled(gaussians, rows[anchor] * slots + chosen % slots, opacity.detach())


class _Assemble(torch.autograd.Function):
    """Inputs: rows, live, positions, then the differentiable opacity … log_gain."""

    @staticmethod
    def forward(ctx: Any, *inputs: Tensor) -> tuple[Tensor, ...]:
        rows, live, positions, opacity, cov, color, log_scales, offsets, log_gain = (
            t.detach() for t in inputs
        )
        seen = live.view(torch.uint8)
        arrays = (rows, seen, opacity, cov, color, positions, log_scales, offsets, log_gain)
        slots: Any = tuple(t.numpy() for t in arrays)
        activated = torch.empty_like(opacity)
        starts = torch.empty(len(rows) + 1, dtype=torch.int64)
        threads = thread_count()
        count = _core.count_drawn(slots, activated.numpy(), starts.numpy(), threads)
        out = tuple(torch.empty(count, *shape) for shape in SHAPES)
        flat = torch.empty(count, dtype=torch.int64)
        drawn = (activated.numpy(), starts.numpy())
        made: Any = tuple(t.numpy() for t in out)
        _core.assemble(slots, drawn, made, flat.numpy(), threads)
        ctx.save_for_backward(*arrays, activated, starts)
        ctx.mark_non_differentiable(flat, activated)
        return *out, flat, activated

    @staticmethod
    @once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx: Any, *grads: Tensor
    ) -> tuple[Tensor | None, ...]:
        *arrays, activated, starts = ctx.saved_tensors
        opacity, cov, color, _, log_scales, offsets, log_gain = arrays[2:]
        heads = tuple(torch.empty_like(t) for t in (opacity, cov, color))
        dense = (torch.zeros_like(log_scales), torch.zeros_like(offsets))
        shares, gain = torch.empty(len(opacity), 3), torch.empty_like(log_gain)
        slots: Any = tuple(t.numpy() for t in arrays)
        drawn = (activated.numpy(), starts.numpy())
        given: Any = tuple(g.contiguous().numpy() for g in grads[: len(SHAPES)])
        wanted: Any = tuple(t.numpy() for t in (*heads, *dense))
        threads = thread_count()
        _core.assemble_backward(slots, drawn, given, wanted, shares.numpy(), gain.numpy(), threads)
        return None, None, None, *heads, *dense, gain
