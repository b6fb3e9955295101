"""One view of a level by native kernels, forward and backward: cull, heads, slots, render.

Letters: N anchors, V of them visible, K slots, C codebook rows, G rendered Gaussians. `decode.py`
has the same in plain PyTorch, the oracle.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gsynopsis._native import _core
from gsynopsis._native.runtime import empty_buffer, empty_buffer_like, thread_count
from gsynopsis.model.encoding import level_arrays
from gsynopsis.model.tables import Decoded, HeadInputs, LevelInputs, SlotTables, ViewInput
from gsynopsis.records import HEAD_NAMES, VIEW_INPUTS
from gsynopsis.render.base import Gaussians, Rendering
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import Camera

COLUMNS = 16
"""Rows of the native pass are padded to a multiple of this many floats."""
SHAPES = ((3,), (4,), (3,), (), (3,))
"""A Gaussian's mean, quaternion, scale, opacity and colour."""


class NativePass:
    """One view of a level: decoded and rendered by native kernels, then their gradients in order.

    Only the loss goes through autograd: image, scales and opacities are its leaves, and their
    gradients enter the kernels.
    """

    def __init__(self, renderer: CpuRenderer, camera: Camera, inputs: LevelInputs) -> None:
        """Decode: heads of the anchors in view, then the Gaussians of their live slots."""
        self.renderer, self.camera, self.inputs = renderer, camera, inputs
        rows = inputs.heads.rows
        with torch.no_grad():
            self._heads = HeadsKernel(inputs.heads, inputs.view, inputs.weights)
            opacity, cov, color = self._heads.forward()
            self._slots = SlotsKernel((opacity, cov, color), rows, inputs.tables)
            *values, slots, shown = self._slots.forward()
        self._gaussians = Gaussians(*values, focals=inputs.focals)
        self._scales = self._gaussians.scales.detach().requires_grad_(True)
        self._opacities = self._gaussians.opacities.detach().requires_grad_(True)
        leaves = replace(self._gaussians, scales=self._scales, opacities=self._opacities)
        self.decoded = Decoded(leaves, rows, slots, shown)

    def render(self, dropout: Tensor | None, background: Tensor) -> Rendering:
        """The image [H, W, 3], a leaf.

        Args:
            dropout: Factors on the opacities, [G]; None: ones.
            background: Color behind everything, [3].
        """
        gaussians, self._dropout = self._gaussians, dropout
        with torch.no_grad():
            if dropout is not None:
                gaussians = replace(gaussians, opacities=gaussians.opacities * dropout)
            self._rendering = self.renderer.render_pass(gaussians, self.camera, background)
        self._image = self._rendering.image.detach().requires_grad_(True)
        return replace(self._rendering.rendering, image=self._image)

    def backward(self, loss: Tensor) -> None:
        """Add the gradients of a loss [] of `decoded` and the image to the model's parameters."""
        if loss.requires_grad:
            loss.backward()
        if self._image.grad is None:
            return
        # Of means, quaternions, scales, opacities and colors.
        grads = self._rendering.backward(self._image.grad)
        if self._dropout is not None:
            grads[3].mul_(self._dropout)
        for place, leaf in ((2, self._scales), (3, self._opacities)):
            if leaf.grad is not None:
                grads[place] += leaf.grad
        self._backward_to_parameters(grads)

    def _backward_to_parameters(self, grads: Sequence[Tensor]) -> None:
        """Add to `grad` of every parameter that wants one, as autograd would."""
        s, t = self.inputs.heads, self.inputs.tables
        heads, of_slots = self._slots.backward(
            grads, (t.log_scales.requires_grad, t.offsets.requires_grad)
        )
        wanted = [leaf.requires_grad for leaf in (s.table, s.logits, s.residual)]
        of_heads = self._heads.backward(heads, wanted)
        leaves = (t.log_scales, t.offsets, t.log_gain)
        weights = (s.table, s.logits, s.codebook, s.residual, *self.inputs.weights)
        for leaf, grad in zip((*leaves, *weights), (*of_slots, *of_heads), strict=True):
            if grad is None or not leaf.requires_grad or grad is leaf.grad:
                continue
            if leaf.grad is None:
                leaf.grad = grad
            else:
                leaf.grad += grad


def native_rows(tables: SlotTables, camera: Camera) -> Tensor:
    """Anchors whose Gaussians could touch the image, int64 [V] ascending; on the CPU, float32.

    A frustum test on the anchor with the margin 3·max scale + max |offset|·offset scale
    (methods.md §1.6.1); dead slots do not widen the margin, and an anchor without a live one is
    left out.
    """
    t = tables
    arrays = (t.positions, t.log_scales, t.offsets, t.live.view(torch.uint8))
    anchors: Any = tuple(a.detach().contiguous().numpy() for a in arrays)
    rows = torch.empty(len(t.positions) + 1, dtype=torch.int64)
    w2c = np.ascontiguousarray(camera.w2c, dtype=np.float32)
    count = _core.visible_rows(
        (*anchors, float(t.log_gain.detach().exp().max())),
        w2c,
        (camera.fx, camera.fy, camera.cx, camera.cy),
        (camera.width, camera.height),
        rows.numpy(),
        thread_count(),
    )
    return rows[:count]


class HeadsKernel:
    """Features and heads of visible anchors, and their gradients.

    Table, logits and residual are the largest gradients of all. Where a step has already given
    them one, as the first of two levels does, the backward pass adds to it in place.
    """

    def __init__(self, sources: HeadInputs, view: ViewInput, weights: Sequence[Tensor]) -> None:
        """Nothing is computed yet.

        Args:
            sources: On the CPU, float32.
            view: Where the camera is.
            weights: Those of `WEIGHTS`, in that order.
        """
        self.sources, self.view = sources, view
        self.grids = len(sources.layout.sizes) * sources.layout.features
        self.weights = [w.detach().contiguous() for w in weights]
        self.logits, self.codebook, self.residual = (
            t.detach().contiguous() for t in (sources.logits, sources.codebook, sources.residual)
        )

    def forward(self) -> tuple[Tensor, ...]:
        """The heads before their activations, as `compute_heads`."""
        s, count, threads = self.sources, len(self.sources.rows), thread_count()
        table = s.table.detach().contiguous()
        self.x, self.points = _head_rows(s, self.view, table, self.residual, threads)
        self.codes = _codes(s, self.logits, self.codebook, threads)
        self.hidden = empty_buffer(count, len(HEAD_NAMES) * _padded(self.weights[0].shape[0]))
        outputs = tuple(empty_buffer(count, w2.shape[0]) for w2 in self.weights[2::4])
        _core.heads_forward(self._networks(), self._rows(outputs), threads)
        return outputs

    def backward(self, grads: Sequence[Tensor], needed: Sequence[bool]) -> list[Tensor | None]:
        """Gradients of table, logits, codebook, residual and the weights.

        Args:
            grads: Gradients of the outputs.
            needed: Flags of table, logits and residual: True if its gradient is needed.

        Returns:
            None for an unneeded gradient; a leaf's own `grad` where it was added to.
        """
        s, grids, threads = self.sources, self.grids, thread_count()
        grad_x = empty_buffer(len(self.x), _padded(grids + self.residual.shape[1]))
        grad_weights = [torch.empty_like(w) for w in self.weights]
        grad_codebook = torch.empty_like(self.codebook)
        grad_logits = gradient_of(s.logits, needed[1], empty_buffer_like)
        choice: Any = None
        if grad_logits is not None and grad_logits.numel():
            more = grad_logits is s.logits.grad
            choice = self.logits.numpy(), s.rows.numpy(), grad_logits.numpy(), more
        _core.heads_backward(
            self._networks(),
            self._rows(tuple(g.contiguous() for g in grads)),
            grad_x.numpy(),
            [g.numpy() for g in grad_weights],
            grad_codebook.numpy(),
            choice,
            threads,
        )
        grad_table = gradient_of(s.table, needed[0], torch.zeros_like)
        if grad_table is not None and grids:
            levels = level_arrays(s.layout)
            _core.hashgrid_backward(
                self.points.numpy(), grad_x.numpy(), *levels, grad_table.numpy(), threads
            )
        grad_residual = gradient_of(s.residual, needed[2], empty_buffer_like)
        if grad_residual is not None:
            more = grad_residual is s.residual.grad
            arrays = s.rows.numpy(), grad_x.numpy(), grids, grad_residual.numpy()
            _core.scatter_rows(*arrays, more, threads)
        return [grad_table, grad_logits, grad_codebook, grad_residual, *grad_weights]

    def _networks(self) -> Any:
        widths = self.grids, self.residual.shape[1]
        return ([w.numpy() for w in self.weights], self.codebook.numpy(), *widths)

    def _rows(self, outputs: tuple[Tensor, ...]) -> Any:
        codes = None if self.codes is None else self.codes.numpy()
        return self.x.numpy(), codes, self.hidden.numpy(), [t.numpy() for t in outputs]


def _head_rows(
    s: HeadInputs, view: ViewInput, table: Tensor, residual: Tensor, threads: int
) -> tuple[Tensor, Tensor]:
    """Rows of what goes into the heads but the codebook's, and the points where grids are read."""
    grids = len(s.layout.sizes) * s.layout.features
    x = empty_buffer(len(s.rows), _padded(grids + residual.shape[1] + VIEW_INPUTS + 1))
    arrays = s.rows.numpy(), s.positions.numpy(), residual.numpy()
    known = view.extent, view.low, view.high
    _core.fill_inputs(*arrays, view.position, known, grids, x.numpy(), threads)
    if not grids:
        return x, torch.empty(0, 3)
    points = s.coordinates[s.rows]
    _core.hashgrid_forward(
        points.numpy(), table.numpy(), *level_arrays(s.layout), x.numpy(), threads
    )
    return x, points


def _codes(sources: HeadInputs, logits: Tensor, codebook: Tensor, threads: int) -> Tensor | None:
    if not codebook.shape[0]:
        return None
    if not logits.shape[1]:
        return sources.codes[sources.rows]
    codes = torch.empty_like(sources.rows)
    _core.choose(logits.numpy(), sources.rows.numpy(), codes.numpy(), threads)
    return codes


def _padded(width: int) -> int:
    return -(-width // COLUMNS) * COLUMNS


class SlotsKernel:
    """Head outputs of visible anchors to Gaussians, and gradients back to them.

    Where a step has already given scales and offsets a gradient, the backward pass adds to it in
    place, as in `HeadsKernel`.
    """

    def __init__(
        self, heads: tuple[Tensor, Tensor, Tensor], rows: Tensor, tables: SlotTables
    ) -> None:
        """Nothing is computed yet; arguments as in `decode.assemble`, on the CPU, float32."""
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


def gradient_of(leaf: Tensor, needed: bool, make: Callable[[Tensor], Tensor]) -> Tensor | None:
    """The gradient that a leaf has and that may be added to, else a new one."""
    if not needed:
        return None
    held = leaf.grad if leaf.is_leaf else None
    return held if held is not None and held.is_contiguous() else make(leaf.detach())
