"""Features and heads of visible anchors: one native pass on the CPU, plain PyTorch elsewhere.

Letters: N anchors, V of them visible, K slots, C codebook rows.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from gsynopsis._native import _core
from gsynopsis._native.runtime import empty_buffer, empty_buffer_like, thread_count
from gsynopsis.model.encoding import GridLayout, StraightThrough, grid_features, level_arrays
from gsynopsis.model.heads import Networks, fuse_features, head_outputs
from gsynopsis.records import HEAD_NAMES, VIEW_INPUTS
from gsynopsis.render.base import sent

COLUMNS = 16
"""Rows of the native pass are padded to a multiple of this many floats."""
WEIGHTS = tuple(f"{head}_{part}" for head in HEAD_NAMES for part in ("w1", "b1", "w2", "b2"))


@dataclass(frozen=True)
class HeadInputs:
    """Inputs of the heads.

    Attributes:
        rows: Visible anchors, int64 [V], strictly ascending.
        positions: [N, 3], world units.
        coordinates: [N, 3] in [0, 1], where grids are sampled.
        layout: The grids that are sampled.
        table: Their rows; may hold more grids.
        logits: [N, C] while the choice of a codebook row is learnt, else [N, 0].
        codes: int64 [N] once it is frozen; used where there are no logits.
        codebook: [C, D]; C may be 0.
        residual: [N, R]; R may be 0.
    """

    rows: Tensor
    positions: Tensor
    coordinates: Tensor
    layout: GridLayout
    table: Tensor
    logits: Tensor
    codes: Tensor
    codebook: Tensor
    residual: Tensor


@dataclass(frozen=True)
class ViewInput:
    """Camera position for the heads' direction and distance inputs.

    Attributes:
        position: World units [3].
        extent: Unit of distance, world units.
        low: Smaller distances count as this, in that unit; a float32 value.
        high: Larger distances count as this, in that unit; a float32 value.
    """

    position: tuple[float, float, float]
    extent: float
    low: float = 0.0
    high: float = math.inf


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


class HeadsKernel:
    """The native pass and its saved tensors: `compute_heads`, autograd left to the caller.

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
        self.x, self.points = _inputs(s, self.view, table, self.residual, threads)
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


def gradient_of(leaf: Tensor, needed: bool, make: Callable[[Tensor], Tensor]) -> Tensor | None:
    """The gradient that a leaf has and that may be added to, else a new one."""
    if not needed:
        return None
    held = leaf.grad if leaf.is_leaf else None
    return held if held is not None and held.is_contiguous() else make(leaf.detach())


def fresh(grad: Tensor | None, leaf: Tensor) -> Tensor | None:
    """A gradient for autograd to add; None if it is the leaf's own, where it already is."""
    return None if leaf.is_leaf and grad is leaf.grad else grad


def _inputs(
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
