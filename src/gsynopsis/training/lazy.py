"""Rows of anchors that Adam moves only when they are read, to the bits of the dense optimiser.

A row without a gradient goes on moving by its momentum. Nothing sees that before the row is read:
until then a step costs it nothing, and then it is caught up with every step that it has missed, one
after the other, each with its own rate and bias corrections. A view reads the rows that could be in
it. Which those are is found from bounds, kept for every anchor, on how large it can get by its
momentum alone.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from gsynopsis._native import _core
from gsynopsis._native.threads import thread_count
from gsynopsis.model.anchors import RowsNear
from gsynopsis.model.culling import camera_arrays
from gsynopsis.scene.camera import Camera
from gsynopsis.training.world import pairwise_sum

EPSILON = 1e-15
BETA_MEAN, BETA_SQUARE = 0.9, 0.999
MOST_ROOT = 32.0
"""1 / √(1 − β₂ᵗ) is largest in the first step, 31.6."""
DRIFT_SLACK = 1.01
"""Far more than rounding, in hundreds of steps, adds to a bound."""
MOMENTS = ("exp_avg", "exp_avg_sq")
TAIL = 64
"""Elements at a tensor's end, at least, that PyTorch may average otherwise than by its vectors."""
FEWEST_TICKS = 64


@dataclass
class RowTensor:
    """A parameter [N, …] and its state in the optimiser, empty until it first moves.

    Attributes:
        parameter: Values; rows that were not read lately are out of date.
        state: As in `Optimiser.state`.
        rate: Learning rate of the next step.
        least: What the rate will end at.
    """

    parameter: nn.Parameter
    state: dict[str, Tensor]
    rate: float
    least: float

    def flat(self, values: Tensor) -> Any:
        """As an array [N, W]."""
        return values.detach().flatten(1).numpy()

    def arrays(self) -> tuple[Any, ...]:
        """Values and both moments so."""
        return tuple(map(self.flat, (self.parameter, *(self.state[m] for m in MOMENTS))))


@dataclass
class RowGradients:
    """Gradients of some rows.

    Attributes:
        rows: int64 [V] ascending.
        values: By name [V, …]; parameters without one are left out.
    """

    rows: Tensor
    values: dict[str, Tensor]


class Ticks:
    """What all rows went through since they were caught up: rate, factor and share of each tensor.

    A tick is a step or an averaging of weights. A factor of 0 stands where the tensor does not
    move, a share of -1 where it is not averaged.
    """

    def __init__(self, names: Sequence[str]) -> None:
        """None yet."""
        self.count = 0
        self._room = {name: np.empty((3, FEWEST_TICKS), np.float32) for name in names}

    def add(self, moved: Mapping[str, tuple[float, float]]) -> None:
        """A step of some tensors, by its two factors."""
        for name, room in self._room.items():
            if self.count == room.shape[1]:
                room = self._room[name] = np.concatenate([room, np.empty_like(room)], axis=1)
            room[:, self.count] = *moved.get(name, (0, 0)), -1
        self.count += 1

    def add_average(self, names: Sequence[str], share: float) -> None:
        """Weights are averaged, and nothing moves."""
        self.add({})
        for name in names:
            self._room[name][2, self.count - 1] = share

    def of(self, name: str) -> tuple[NDArray[np.float32], ...]:
        """Rates, factors and shares."""
        return tuple(row[: self.count] for row in self._room[name])


class LazyRows:
    """Row parameters of an optimiser, moved when they are read.

    Attributes:
        tensors: By name.
    """

    def __init__(self, tensors: Mapping[str, RowTensor]) -> None:
        """All rows are up to date."""
        self.tensors = dict(tensors)
        self._near: RowsNear | None = None
        self._given: RowGradients | None = None
        self._most = dict[str, float].fromkeys(tensors, 0.0)
        self._leaves: Mapping[str, nn.Parameter] = {}
        self._begin()

    def _begin(self) -> None:
        """All rows are up to date."""
        self.ticks = Ticks(list(self.tensors))
        count = len(next(iter(self.tensors.values())).parameter)
        self._stamps = np.zeros(count, np.int32)
        self._bounds: tuple[NDArray[np.float32], ...] | None = None

    def replace(self, name: str, tensor: RowTensor) -> None:
        """A tensor with other rows; its turn comes for each of them, after `settle`."""
        self.tensors[name] = tensor
        self._begin()

    def near(
        self, leaves: Mapping[str, nn.Parameter], positions: Tensor, camera: Camera, gain: float
    ) -> RowsNear:
        """What a camera could see, caught up; gradients of a step add up in it.

        Args:
            leaves: All row parameters of the model, of which some may not be moved.
            positions: Of all anchors, [N, 3].
            camera: Any camera.
            gain: The largest factor on scales that any level has.
        """
        self._leaves = leaves
        size, reach = self._bounded()
        rows = torch.empty(len(positions) + 1, dtype=torch.int64)
        seen, threads = camera_arrays(camera), thread_count()
        count = _core.rows_near(positions, size, reach, gain, *seen, rows, threads)
        rows, held = rows[:count], self._near
        if held is not None:
            if len(rows) == len(held.rows) and torch.equal(rows, held.rows):
                return held
            rows = torch.cat([held.rows, rows]).unique()
        self._catch_up(rows)
        near = RowsNear.taken(leaves, rows)
        if held is not None:
            self._hand_over(held, near)
        self._near = near
        return near

    def take(self) -> RowGradients | None:
        """Gradients since the last call, which are dropped; None where nothing was read."""
        near, given = self._near, self._given
        self._near = self._given = None
        if near is None:
            return given
        found = {n: leaf.grad for n, leaf in near.values.items() if leaf.grad is not None}
        return RowGradients(near.rows, {n: g for n, g in found.items() if n in self.tensors})

    def give(self, pieces: Sequence[RowGradients | None], count: int) -> None:
        """The mean over `count` views, from what `take` gave after each."""
        there = [piece for piece in pieces if piece is not None]
        if not there:
            return
        rows = torch.cat([piece.rows for piece in there]).unique()
        names = [n for n in self.tensors if any(n in piece.values for piece in there)]
        mean = {
            name: pairwise_sum([self._spread(name, piece, rows) for piece in pieces]) / count
            for name in names
        }
        self._given = RowGradients(rows, mean)

    def keep(self, moving: Tensor) -> None:
        """Gradients of anchors that do not move, bool [N], become zero."""
        self._given = self.take()
        if self._given is not None:
            still = ~moving[self._given.rows]
            for gradient in self._given.values.values():
                gradient[still] = 0

    def has_whole_gradients(self) -> bool:
        """Whether a gradient came for all rows, from a pass that does not know these."""
        return any(tensor.parameter.grad is not None for tensor in self.tensors.values())

    def step(self) -> None:
        """Move the rows that have a gradient, and note the step for the others."""
        for name, tensor in self.tensors.items():
            if tensor.rate > self._most[name]:
                self._bounds = None  # they hold for smaller rates
            self._most[name] = max(tensor.rate, tensor.least)
        found = self.take()
        gradients = {} if found is None else found.values
        factors, moved = {}, []
        for name, gradient in gradients.items():
            tensor = self.tensors[name]
            begin_state(tensor.parameter, tensor.state)
            tensor.state["step"] += 1
            factors[name] = _core.adam_factors(tensor.rate, float(tensor.state["step"]))
            moved.append((*tensor.arrays(), tensor.flat(gradient), *factors[name]))
        if found is not None:
            self._catch_up(found.rows)
        self.ticks.add(factors)
        if found is None or not moved:
            return
        rows: Any = found.rows.numpy()
        _core.adam_rows(moved, rows, EPSILON, thread_count())
        self._stamps[rows] = self.ticks.count
        if self._bounds is not None:
            self._bound(rows)

    def average(self, share: float) -> None:
        """Weight averaging of what ever moved, as `Optimiser.average`."""
        moved = {n: t for n, t in self.tensors.items() if t.state and t.parameter.numel()}
        if not moved:
            return
        for tensor in moved.values():
            if "average" not in tensor.state:
                self._catch_up(None)
                tensor.state["average"] = tensor.parameter.detach().clone()
        # PyTorch averages the last few elements otherwise, so it does it here.
        count = len(self._stamps)
        width = {n: t.parameter.numel() // count for n, t in moved.items()}
        tail = min(t.parameter.numel() // TAIL * TAIL // width[n] for n, t in moved.items())
        self._catch_up(torch.arange(tail, count))
        self.ticks.add_average(list(moved), share)
        for name, tensor in moved.items():
            _average_from(tensor, tail * width[name], share)
        self._stamps[tail:] = self.ticks.count

    def settle(self) -> None:
        """Catch up every row; averages too."""
        self._catch_up(None)
        self._begin()

    def _catch_up(self, rows: Tensor | None) -> None:
        if not self.ticks.count:
            return
        late: Any = []
        for name, tensor in self.tensors.items():
            if tensor.state:
                average = tensor.state.get("average")
                averages = None if average is None else tensor.flat(average)
                late.append((*tensor.arrays(), averages, *self.ticks.of(name)))
        if late:
            which = None if rows is None else rows.numpy()
            _core.catch_up(late, which, self._stamps, EPSILON, thread_count())

    def _bounded(self) -> tuple[NDArray[np.float32], ...]:
        if self._bounds is None:
            self._catch_up(None)
            count = len(self._stamps)
            self._bounds = np.empty(count, np.float32), np.empty(count, np.float32)
            self._bound(None)
        return self._bounds

    def _bound(self, rows: Any) -> None:
        if self._bounds is not None:
            sizes, offsets = (self._drift(n, self._leaves[n]) for n in ("log_scales", "offsets"))
            size, reach = self._bounds
            _core.bound_rows(sizes, offsets, rows, size, reach, thread_count())

    def _drift(self, name: str, values: nn.Parameter) -> Any:
        tensor = self.tensors.get(name)
        if tensor is None or not tensor.state:
            return values.detach().numpy(), None, None, 0.0, 1.0
        moments = [tensor.state[moment].numpy() for moment in MOMENTS]
        steps = self._most[name] * drift_steps(float(tensor.state["step"]))
        return values.detach().numpy(), *moments, steps, EPSILON / MOST_ROOT

    def _hand_over(self, held: RowsNear, near: RowsNear) -> None:
        places = torch.searchsorted(near.rows, held.rows)
        for name, leaf in held.values.items():
            if leaf.grad is not None:
                grad = torch.zeros_like(near.values[name])
                grad[places] = leaf.grad
                near.values[name].grad = grad

    def _spread(self, name: str, piece: RowGradients | None, rows: Tensor) -> Tensor:
        spread = torch.zeros(len(rows), *self.tensors[name].parameter.shape[1:])
        if piece is not None and name in piece.values:
            spread[torch.searchsorted(rows, piece.rows)] = piece.values[name]
        return spread


def drift_steps(step: float) -> float:
    """How far momentum alone can ever carry a weight after a step, from 1.

    In units of the largest rate to come times |mean| / (√square + ε / MOST_ROOT): j steps later the
    mean has shrunk to 0.9ʲ and the root of the square to no less than 0.999^(j/2).
    """
    later = np.arange(1, 400)
    shrunk = (BETA_MEAN / math.sqrt(BETA_SQUARE)) ** later
    means, squares = (1 - beta ** (step + later) for beta in (BETA_MEAN, BETA_SQUARE))
    return DRIFT_SLACK * float((shrunk * np.sqrt(squares) / means).sum())


def begin_state(parameter: nn.Parameter, state: dict[str, Tensor]) -> None:
    """Zero moments, where a parameter moves for the first time."""
    if not state:
        state["step"] = torch.zeros(())
        state.update({moment: torch.zeros(parameter.shape) for moment in MOMENTS})


def _average_from(tensor: RowTensor, first: int, share: float) -> None:
    values, average = tensor.parameter.detach().view(-1), tensor.state["average"].view(-1)
    start = first // TAIL * TAIL
    made = average[start:].lerp(values[start:], share)
    average[first:] = made[first - start :]
