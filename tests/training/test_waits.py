"""How often a step makes the host wait for the device, counted on the roads that a GPU takes.

On the CPU everything that asks a tensor for a number is counted, but for what the rasteriser does;
on a CUDA device PyTorch tells of each wait itself, and gsplat asks once for a number of its own.
"""

import warnings
from collections import Counter
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

from gsynopsis.config import Config
from gsynopsis.errors import DivergedError
from gsynopsis.render.base import Renderer
from gsynopsis.render.choose import make_renderer
from gsynopsis.training.context import TrainContext
from gsynopsis.training.loop import phases_of, run_training
from gsynopsis.training.observer import Silent
from gsynopsis.training.state import READ_EVERY, TrainState, fresh_state, set_optimizer
from gsynopsis.training.step import sync_losses
from tests.devices import CUDA
from tests.tiny import tiny_config, tiny_scene
from tests.training.test_devices import plain_renderer

COUNTS = 2
"""Waits of a view: how many anchors are in view, and how many of their slots are drawn."""
METHODS = {"item", "tolist", "numpy", "cpu", "__float__", "__bool__", "__int__", "__index__"}
OPERATIONS = {"_local_scalar_dense", "nonzero", "masked_select", "unique_dim", "_unique2", "equal"}


class Methods(TorchFunctionMode):
    """Counts what asks a tensor for its values and is no operation."""

    def __init__(self, found: Counter[str]) -> None:
        super().__init__()
        self.found = found

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if getattr(func, "__name__", "") in METHODS:
            self.found[func.__name__] += 1
        return func(*args, **(kwargs or {}))


class Operations(TorchDispatchMode):
    """Counts operations that need values on the host; indexing by a mask is one."""

    def __init__(self, found: Counter[str]) -> None:
        super().__init__()
        self.found = found

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name = func.__name__.split(".")[0]
        masked = name in ("index", "index_put", "index_put_") and any(
            t is not None and t.dtype == torch.bool for t in args[1]
        )
        if name in OPERATIONS or masked:
            self.found[name] += 1
        return func(*args, **(kwargs or {}))


@contextmanager
def counted(device: torch.device) -> Generator[Counter[str]]:
    found: Counter[str] = Counter()
    if device.type == "cpu":
        with Methods(found), Operations(found):
            yield found
        return
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        torch.cuda.set_sync_debug_mode("warn")
        try:
            yield found
        finally:
            torch.cuda.set_sync_debug_mode("default")
    found.update(str(one.message) for one in told if "called a synchronizing" in str(one.message))


@pytest.fixture(params=["plain", CUDA])
def renderer(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Renderer:
    return make_renderer("cuda") if request.param == "cuda" else plain_renderer(monkeypatch)


def started(config: Config, own: Renderer, phase: int = 0) -> TrainState:
    """A training at the start of a phase, whose losses are read as a GPU's are."""
    state = fresh_state(TrainContext(tiny_scene(), config, own))
    state.losses.read_every = READ_EVERY
    for number, one in enumerate(phases_of(config)[: phase + 1]):
        state.progress.phase = number
        one.begin(state)
        set_optimizer(state, one.make_optimizer(state))
    return state


def waits_of_steps(state: TrainState, phase: int, steps: int) -> Counter[str]:
    """Waits of some steps, after two that are not counted: the first loss is read at once."""
    own = phases_of(state.context.config)[phase]

    def step() -> None:
        own.step(state)
        state.progress.step += 1

    for _ in range(2):
        step()
    with counted(state.context.renderer.device) as found:
        for _ in range(steps):
            step()
    return found


def trained_so(**settings: object) -> Config:
    return replace(tiny_config(), train=replace(tiny_config().train, **settings))  # type: ignore[arg-type]


CONFIGS: dict[str, tuple[Callable[[], Config], int, int, int]] = {
    # settings, phase, its first step here, views that a step decodes
    "full": (tiny_config, 0, 0, 1),
    "joint": (tiny_config, 1, 0, 2),
    # Masks are learnt, and the controller looks at them every tenth step.
    "masks": (lambda: tiny_config(mode="sequential", steps=1000), 1, 61, 1),
    "several views a step": (lambda: trained_so(batch=2), 0, 0, 2),
    "exposures": (lambda: trained_so(exposure="on"), 0, 4, 1),
}


@pytest.mark.parametrize("name", CONFIGS)
def test_a_step_waits_for_two_counts_of_each_view(name: str, renderer: Renderer) -> None:
    settings, phase, first, views = CONFIGS[name]
    state = started(settings(), renderer, phase)
    state.progress.step = first
    found, steps = waits_of_steps(state, phase, 2), 2
    if renderer.device.type == "cuda":  # gsplat asks how many pairs of Gaussian and tile there are
        assert 0 < found.total() <= (COUNTS + 1) * views * steps, found
        return
    if name == "exposures":  # the number of a photo's visits, which is on the host
        assert found.pop("__float__") == found.pop("_local_scalar_dense") == steps
    assert found == {"nonzero": COUNTS * views * steps}


def test_losses_read_together_are_those_read_one_by_one(renderer: Renderer) -> None:
    states = [started(tiny_config(), renderer) for _ in range(2)]
    states[0].losses.read_every = 1
    full = phases_of(tiny_config())[0]
    for state in states:
        for _ in range(12):
            full.step(state)
            state.progress.step += 1
        sync_losses(state)
    if renderer.device.type == "cpu":
        assert states[0].progress == states[1].progress
    assert states[1].progress.loss == pytest.approx(states[0].progress.loss, rel=0.05)


def test_a_training_that_diverges_between_two_readings_is_not_saved(
    renderer: Renderer, tmp_path: Any
) -> None:
    state = started(tiny_config(), renderer)
    state.progress.begun = True
    full = phases_of(tiny_config())[0]
    for _ in range(2):
        full.step(state)
        state.progress.step += 1
    with torch.no_grad():
        state.model.part(-1).networks["opacity_b2"].fill_(torch.nan)
    with pytest.raises(DivergedError, match=r"step 3: view \S+ gives a loss of nan"):
        run_training(state, tmp_path, Silent(), lambda: state.progress.step >= 4, 1e9)
    assert state.progress.step == 4 and not list(tmp_path.iterdir())
