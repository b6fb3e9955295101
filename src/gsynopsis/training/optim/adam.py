"""Adam over named groups whose rows can come and go."""

from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from gsynopsis._native import _core
from gsynopsis._native.runtime import thread_count
from gsynopsis.errors import CheckpointError

BETAS = (0.9, 0.999)
EPSILON = 1e-15
MOMENTS = ("exp_avg", "exp_avg_sq")
STATE = (*MOMENTS, "step", "average")
"""State of a parameter; the last only while weights are averaged."""
MOST_STEPS = 1e12
Group = dict[str, Any]
"""`params`, a list of one; `lr`; `name`."""


class Optimizer:
    """torch's Adam with one group per name, rates by schedule, and row edits for growing.

    On the CPU one native pass moves all tensors; torch's own step is its oracle. Both are dense: a
    row without a gradient goes on moving by its momentum.

    Only parameters that take part in a step and have a gradient move; a parameter without a
    gradient keeps its moments untouched.
    """

    def __init__(
        self, parameters: Mapping[str, nn.Parameter], rates: Mapping[str, tuple[float, float]]
    ) -> None:
        """Start from zero moments.

        Args:
            parameters: By unique name.
            rates: Initial and final learning rate by the same names.
        """
        self.rates = dict(rates)
        self.state: defaultdict[Tensor, dict[str, Tensor]] = defaultdict(dict)
        self._adam: torch.optim.Adam | None = None
        self._flat: dict[Tensor, tuple[int, tuple[Any, ...]]] = {}
        self.groups: list[Group] = [
            {"params": [parameter], "lr": rates[name][0], "name": name}
            for name, parameter in parameters.items()
        ]

    def set_progress(self, progress: float) -> None:
        """Set every rate for progress in [0, 1] of the schedule."""
        for group in self.groups:
            group["lr"] = log_linear(*self.rates[group["name"]], progress)

    def step(self) -> None:
        """Move every parameter that has a gradient; then drop the gradients."""
        moving = [g for g in self.groups if g["params"][0].grad is not None]
        if all(_is_plain(group["params"][0]) for group in moving):
            self._step_native(moving)
        else:
            self._torch().step()
        for parameter in self.parameters():
            parameter.grad = None

    def _torch(self) -> torch.optim.Adam:
        """The step of torch, over the same groups and states."""
        if self._adam is None:
            # Made when it is needed: it imports torch's compiler, a second or more.
            self._adam = torch.optim.Adam([{"params": []}], eps=EPSILON, fused=True)
            for group in self.groups:
                group.update({**self._adam.defaults, **group})
            self._adam.param_groups, self._adam.state = self.groups, self.state
        return self._adam

    def _step_native(self, moving: list[Group]) -> None:
        tensors: Any = []
        for group in moving:
            parameter = group["params"][0]
            state = self.begin_step(parameter)
            value, *moments = self._arrays(parameter, state)
            gradient = parameter.grad.view(-1).numpy()
            tensors.append((value, gradient, *moments, group["lr"], float(state["step"])))
        _core.adam(tensors, EPSILON, thread_count())

    def begin_step(self, parameter: nn.Parameter) -> dict[str, Tensor]:
        """The state of a parameter that is about to move once more; zero moments at first."""
        state = self.state[parameter]
        if not state:
            state["step"] = torch.zeros(())
            state.update({moment: torch.zeros(parameter.shape) for moment in MOMENTS})
        state["step"] += 1
        return state

    def _arrays(self, parameter: nn.Parameter, state: Mapping[str, Tensor]) -> tuple[Any, ...]:
        """A parameter and its moments as flat arrays, the same ones while they stay in place."""
        place = parameter.data_ptr()
        held = self._flat.get(parameter)
        if held is None or held[0] != place:
            tensors = parameter.detach(), *(state[moment] for moment in MOMENTS)
            held = self._flat[parameter] = place, tuple(t.view(-1).numpy() for t in tensors)
        return held[1]

    def average(self, share: float) -> None:
        """Weight averaging: all that ever moved counts with `share` in (0, 1]."""
        for parameter in self.parameters():
            state = self.state.get(parameter)
            if state:
                if "average" not in state:
                    state["average"] = parameter.detach().clone()
                state["average"].lerp_(parameter.detach(), share)

    def take_average(self) -> None:
        """Give every parameter its running average, where there is one."""
        for parameter in self.parameters():
            average = self.state.get(parameter, {}).pop("average", None)
            if average is not None:
                parameter.data.copy_(average)

    def parameters(self) -> list[nn.Parameter]:
        """All parameters that this optimizer moves."""
        return [group["params"][0] for group in self.groups]

    def parameter(self, name: str) -> nn.Parameter:
        """The parameter of a group."""
        return self._group(name)["params"][0]

    def replace(self, name: str, parameter: nn.Parameter, keep: Tensor, added: int) -> None:
        """Put a parameter with other rows in a group: kept rows keep their moments, new have none.

        The average of a new row begins with the row itself.

        Args:
            name: The group.
            parameter: The new parameter, rows = kept rows then `added` new ones.
            keep: Rows of the old parameter that stay, bool [N].
            added: Number of new rows.
        """
        group = self._group(name)
        state = self.state.pop(group["params"][0], None)
        self._flat.pop(group["params"][0], None)
        group["params"][0] = parameter
        if state:
            new = parameter.detach()[len(parameter) - added :]
            for moment in MOMENTS:
                state[moment] = torch.cat([state[moment][keep], torch.zeros_like(new)])
            if "average" in state:
                state["average"] = torch.cat([state["average"][keep], new])
            self.state[parameter] = state

    def tensors(self) -> dict[str, Tensor]:
        """All state by name, for a checkpoint."""
        named: dict[str, Tensor] = {}
        for group in self.groups:
            for key, value in self.state.get(group["params"][0], {}).items():
                named[f"{group['name']}.{key}"] = value
        return named

    def load(self, tensors: Mapping[str, Tensor], path: Path | None = None) -> None:
        """The inverse of `tensors`.

        Args:
            tensors: By name.
            path: Of the checkpoint that they are from.

        Raises:
            CheckpointError: they are not of these parameters.
        """
        self._flat.clear()
        for group in self.groups:
            name = group["name"]
            if f"{name}.step" in tensors:
                _check_state(group, tensors, path)
                self.state[group["params"][0]] = {
                    key: tensors[f"{name}.{key}"].clone()
                    for key in STATE
                    if f"{name}.{key}" in tensors
                }

    def _group(self, name: str) -> Group:
        return next(g for g in self.groups if g["name"] == name)


def _check_state(group: Group, tensors: Mapping[str, Tensor], path: Path | None) -> None:
    """A group's state is that of its parameter."""
    parameter, name = group["params"][0], group["name"]
    found = {key: tensors.get(f"{name}.{key}") for key in STATE}
    for key, tensor in found.items():
        shape, dtype = parameter.shape, parameter.dtype
        if key == "step":
            shape, dtype = torch.Size(), torch.float32
        if tensor is None and key == "average":
            continue
        if tensor is None or tensor.shape != shape or tensor.dtype != dtype:
            told = "nothing" if tensor is None else f"{tensor.dtype}{list(tensor.shape)}"
            raise CheckpointError(
                path or "optimizer",
                f"adam.{name}.{key}",
                found=told,
                expected=f"{dtype}{list(shape)}",
                advice="delete it to start again",
            )
    if not 0 <= float(tensors[f"{name}.step"]) <= MOST_STEPS:
        found = float(tensors[f"{name}.step"])
        raise CheckpointError(
            path or "optimizer", f"adam.{name}.step", found=found, expected="a number of steps"
        )


def _is_plain(parameter: nn.Parameter) -> bool:
    grad = parameter.grad
    whole = grad is not None and grad.is_contiguous() and parameter.is_contiguous()
    return whole and parameter.device.type == "cpu" and parameter.dtype == torch.float32


def log_linear(initial: float, final: float, progress: float) -> float:
    """Interpolate on a log scale; progress in [0, 1]. Zero stays zero."""
    if initial <= 0:
        return 0.0
    return initial * (final / initial) ** min(max(progress, 0.0), 1.0)
