"""A level's Gaussians for one camera with autograd: native on the CPU, plain PyTorch elsewhere.

Letters: N anchors, V of them visible, K slots, C codebook rows, G rendered Gaussians.
"""

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn import functional

from gsynopsis.model.encoding import StraightThrough, grid_features
from gsynopsis.model.heads import Networks, fuse_features, head_outputs
from gsynopsis.model.native_view import HeadsKernel, SlotsKernel
from gsynopsis.model.tables import WEIGHTS, Assembled, HeadInputs, SlotTables, ViewInput
from gsynopsis.render.base import NEAR_PLANE, Gaussians, sent
from gsynopsis.scene.camera import Camera


def visible_rows_reference(tables: SlotTables, camera: Camera) -> Tensor:
    """`native_rows` in plain PyTorch, any dtype and device: the oracle.

    The host waits once, for how many there are.
    """
    t = tables
    with torch.no_grad():
        x = t.positions
        w2c = sent(torch.as_tensor(camera.w2c, dtype=x.dtype), x.device)
        base = t.log_scales.exp()
        live = t.offsets.abs().amax(dim=2) * t.live
        gain = t.log_gain.exp().max()
        margin = 3 * gain * base[:, 3:].amax(dim=1) + live.amax(dim=1) * base[:, :3].amax(dim=1)
        p = x @ w2c[:3, :3].T + w2c[:3, 3]
        z = p[:, 2].clamp(min=5 * NEAR_PLANE)
        px, mx = camera.fx * p[:, 0] / z, camera.fx * margin / z
        py, my = camera.fy * p[:, 1] / z, camera.fy * margin / z
        inside = t.live.any(dim=1) & (p[:, 2] + margin > NEAR_PLANE) & (px + mx > -camera.cx)
        inside &= (px - mx < camera.width - camera.cx) & (py + my > -camera.cy)
        inside &= py - my < camera.height - camera.cy
        return inside.nonzero()[:, 0]


def compute_heads(
    sources: HeadInputs, view: ViewInput, networks: Networks
) -> tuple[Tensor, Tensor, Tensor]:
    """The three heads before their activations: opacity [V, K], cov [V, 7K], color [V, 3K].

    Native on the CPU in float32 where there is no fusion MLP.
    """
    plain = sources.positions.device.type != "cpu" or sources.residual.dtype != torch.float32
    if plain or "fuse_w1" in networks:
        return heads_reference(sources, view, networks)
    s = sources
    return _Heads.apply(  # type: ignore[no-any-return]
        sources,
        view,
        *(s.table, s.logits, s.codebook, s.residual),
        *(networks[name] for name in WEIGHTS),
    )


def heads_reference(
    sources: HeadInputs, view: ViewInput, networks: Networks
) -> tuple[Tensor, Tensor, Tensor]:
    """`compute_heads` in plain PyTorch, any dtype and device: the oracle.

    Rows are read by `index_select`, whose gradient adds them up without sorting their numbers.
    """
    s = sources

    def visible(values: Tensor) -> Tensor:
        return values.index_select(0, s.rows)

    x = visible(s.positions)
    pieces = [grid_features(visible(s.coordinates), s.table, s.layout)]
    if s.codebook.shape[0]:
        if s.logits.shape[1]:
            pieces.append(StraightThrough.apply(visible(s.logits), s.codebook))
        else:
            pieces.append(s.codebook.index_select(0, visible(s.codes)))
    else:  # a codebook of no rows reads as zeros (format.md §5)
        pieces.append(x.new_zeros(len(x), s.codebook.shape[1]))
    pieces.append(visible(s.residual))
    features = fuse_features(networks, torch.cat(pieces, dim=1))
    away = x - sent(torch.tensor(view.position, dtype=x.dtype), x.device)
    distance = away.norm(dim=1, keepdim=True).clamp(min=1e-8)
    known = (distance / view.extent).clamp(view.low, view.high)
    return head_outputs(networks, features, torch.cat([away / distance, known], dim=1))


class _Heads(torch.autograd.Function):
    """Inputs: sources and view, then the differentiable ones: table … residual, the weights."""

    @staticmethod
    def forward(
        ctx: Any, sources: HeadInputs, view: ViewInput, *inputs: Tensor
    ) -> tuple[Tensor, ...]:
        ctx.native = HeadsKernel(sources, view, inputs[4:])
        return ctx.native.forward()

    @staticmethod
    @once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx: Any, *grads: Tensor
    ) -> tuple[Tensor | None, ...]:
        native: HeadsKernel = ctx.native
        s, needs = native.sources, ctx.needs_input_grad
        table, logits, codebook, residual, *weights = native.backward(
            grads, (needs[2], needs[3], needs[5])
        )
        shared = fresh(table, s.table), fresh(logits, s.logits)
        return None, None, *shared, codebook, fresh(residual, s.residual), *weights


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


class _Assemble(torch.autograd.Function):
    """Inputs: rows, tables and the heads, then the differentiable log_scales … log_gain."""

    @staticmethod
    def forward(ctx: Any, rows: Tensor, tables: SlotTables, *inputs: Tensor) -> tuple[Tensor, ...]:
        opacity, cov, color = inputs[:3]
        ctx.native = SlotsKernel((opacity, cov, color), rows, tables)
        *out, flat, activated = ctx.native.forward()
        ctx.mark_non_differentiable(flat, activated)
        return *out, flat, activated

    @staticmethod
    @once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx: Any, *grads: Tensor
    ) -> tuple[Tensor | None, ...]:
        native: SlotsKernel = ctx.native
        t, needs = native.tables, ctx.needs_input_grad
        heads, (sizes, offsets, gain) = native.backward(grads, needs[5:7])
        return None, None, *heads, fresh(sizes, t.log_scales), fresh(offsets, t.offsets), gain


def fresh(grad: Tensor | None, leaf: Tensor) -> Tensor | None:
    """A gradient for autograd to add; None if it is the leaf's own, where it already is."""
    return None if leaf.is_leaf and grad is leaf.grad else grad
