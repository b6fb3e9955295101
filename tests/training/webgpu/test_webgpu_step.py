"""Whole steps on a device beside the CPU's: gradients, statistics, a training's curve and bits."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

import gsynopsis as gs
from gsynopsis.config import Config, ModelConfig
from gsynopsis.jobs.train_run import device_lines
from gsynopsis.render.base import Renderer
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.render.webgpu.renderer import WebGpuRenderer
from gsynopsis.scene.camera import Shift
from gsynopsis.selftest.findings import relative
from gsynopsis.selftest.training_step import check_step, trained_state, twin_of
from gsynopsis.training.context import TrainContext
from gsynopsis.training.distributed.process_group import ProcessGroup
from gsynopsis.training.loop import open_state, run_training
from gsynopsis.training.observer import Silent, StepInfo
from gsynopsis.training.optim.adam import MOMENTS
from gsynopsis.training.phases.full import FullPhase
from gsynopsis.training.state import TrainState, bring_home, fresh_state, set_optimizer
from gsynopsis.training.step import sync_losses
from gsynopsis.training.view_step import train_view
from gsynopsis.training.webgpu.choose import left_to_host
from tests.tiny import PLAIN_JOINT, TINY_MODEL, tiny_config, tiny_scene

TIGHT = 1e-4
"""Largest error of a gradient or a counter, relative to the largest of its tensor."""
PLAIN = ModelConfig(fusion="none", slots=4, grids=0, codebook=0, residual=6, hidden=8)


@dataclass(frozen=True)
class Odd:
    name: str
    anchors: int
    size: tuple[int, int]
    model: ModelConfig = PLAIN
    train: tuple[tuple[str, int | float | str], ...] = ()
    masked: bool = False
    alpha: bool = False
    seed: int = 3
    """One by which no pixel's alpha is so near 1/255 that rounding decides."""

    def config(self) -> Config:
        config = tiny_config()
        settings = {"exposure": "off", "opacity_weight": 0.01, **dict(self.train)}
        train = replace(config.train, **settings)  # type: ignore[arg-type]
        return replace(config, model=self.model, train=train)


ODD = [
    Odd("one pixel", 40, (1, 1)),
    Odd("one anchor", 1, (24, 16)),
    Odd("one slot", 60, (33, 17), replace(PLAIN, slots=1)),
    Odd("32 slots", 30, (17, 40), replace(PLAIN, slots=32)),
    Odd("no values but offsets", 50, (20, 20), replace(PLAIN, residual=0)),
    Odd("wide heads", 80, (48, 31), replace(PLAIN, hidden=40, residual=12)),
    Odd("one column", 60, (1, 50)),
    Odd("one row", 60, (50, 1)),
    Odd("as fast", 120, (48, 32), replace(PLAIN, slots=16, residual=12, hidden=24), seed=5),
    Odd("grids", 90, (24, 16), replace(PLAIN, grids=4, table_log2=6)),
    Odd("codebook", 90, (24, 16), replace(PLAIN, codebook=8, residual=0)),
    Odd("grids and codebook", 90, (24, 16), replace(TINY_MODEL, residual=3)),
    Odd("dropout", 90, (24, 16), PLAIN, (("dropout", 0.3),)),
    Odd("exposure", 90, (33, 16), PLAIN, (("exposure", "on"),)),
    Odd("masks", 90, (24, 16), PLAIN, masked=True),
    Odd("exposure and masks", 90, (24, 16), PLAIN, (("exposure", "on"),), masked=True),
    Odd("alpha", 90, (24, 16), PLAIN, alpha=True),
    Odd("exposure, masks and alpha", 90, (24, 16), PLAIN, (("exposure", "on"),), True, True),
    Odd("70,000 anchors", 70_000, (16, 12), replace(PLAIN, slots=1, residual=2)),
]


def cut_out(view: int, factor: float, shift: Shift) -> Tensor:
    """Opacity of an `Odd`'s photos of 24 × 16: nothing on the left, then all of 256 steps."""
    pixels = torch.randint(256, (16, 24), generator=torch.Generator().manual_seed(view))
    pixels[:, :6] = 0
    pixels[:, 18:] = 255
    return pixels.float() / 255


def state_of(odd: Odd, renderer: Renderer, folder: Path) -> TrainState:
    scene = tiny_scene(size=odd.size, points=odd.anchors)
    if odd.masked:
        pixels = np.random.default_rng(1).integers(0, 256, odd.size[::-1]).astype(np.uint8)
        pixels[:, : odd.size[0] // 2] = 255
        Image.fromarray(pixels).save(folder / "mask.png")
        views = tuple(replace(view, mask=folder / "mask.png") for view in scene.views)
        scene = replace(scene, views=views)
    context = TrainContext(scene, odd.config(), renderer, alpha=cut_out if odd.alpha else None)
    state = fresh_state(context)
    generator, model = torch.Generator().manual_seed(odd.seed), state.model
    with torch.no_grad():
        model.offsets.copy_(torch.randn(model.offsets.shape, generator=generator))
        model.log_scales.add_(torch.randn(model.log_scales.shape, generator=generator) * 0.3)
        if model.table.numel():
            model.table.copy_(torch.randn(model.table.shape, generator=generator))
        model.part(-1).networks["opacity_b2"].fill_(0.3)
    phase = FullPhase(30, 60)
    phase.begin(state)
    set_optimizer(state, phase.make_optimizer(state))
    state.model.part(-1).log_gain.requires_grad_(True)
    state.progress.step = 29
    if state.exposures is not None:  # so bright that saturated pixels of photos count
        state.exposures.log_gains += 1.5
    return state


def gradients(state: TrainState) -> dict[str, Tensor]:
    """Gradients of two views at once, by name; counters are counted."""
    counters, part = state.statistics[0], state.model.part(-1)
    for view, weight in ((state.context.scene.train[0], 1.0), (state.context.scene.train[3], 0.7)):
        train_view(state, part, view, 1.0, weight, counters=counters)
    sync_losses(state)
    whole = state.whole
    found: dict[str, Tensor] = {}
    for name, parameter in state.model.named_parameters():
        grad = parameter.grad
        if whole is not None:
            grad = whole.gradient(parameter)
        if grad is not None and grad.numel():
            found[name] = grad
    bring_home(state)
    return found


@pytest.mark.parametrize("odd", ODD, ids=lambda odd: odd.name)
def test_a_step_is_the_cpu_s(odd: Odd, webgpu: WebGpuRenderer, tmp_path: Path) -> None:
    cpu = CpuRenderer(threads=1)
    oracle, state = state_of(odd, cpu, tmp_path), state_of(odd, webgpu, tmp_path)
    assert state.whole is not None and oracle.whole is None
    expected, found = gradients(oracle), gradients(state)
    assert found.keys() == expected.keys()
    errors = {name: relative(found[name], grad) for name, grad in expected.items()}
    for name, counter in oracle.statistics[0].tensors().items():
        errors[name] = relative(state.statistics[0].tensors()[name], counter)
    if oracle.exposures is not None and state.exposures is not None:
        errors["gains"] = relative(state.exposures.log_gains, oracle.exposures.log_gains)
    errors["loss"] = abs(state.progress.loss / oracle.progress.loss - 1)
    errors["squared error"] = abs(state.progress.error / oracle.progress.error - 1)
    assert {name: error for name, error in errors.items() if not error <= TIGHT} == {}


def step_of_several(renderer: Renderer, folder: Path) -> dict[str, Tensor]:
    """Moments, counters, gains, loss and error after a step of three views that are counted."""
    train = (("batch", 3), ("exposure", "on"))
    state = state_of(Odd("", 60, (16, 12), PLAIN, train), renderer, folder)  # a tile: see `drawn`
    state.progress.step = 10
    FullPhase(30, 60).step(state)
    sync_losses(state)
    bring_home(state)
    assert (state.whole is None) == (renderer.name == "cpu") and state.exposures is not None
    found = {"gains": state.exposures.log_gains}
    found["loss, error"] = torch.tensor([state.progress.loss, state.progress.error])
    for group in state.optimizer.groups:
        for moment in MOMENTS:
            found[f"{group['name']}.{moment}"] = state.optimizer.state[group["params"][0]][moment]
    for place, counters in enumerate(state.statistics):
        found |= {f"{name} {place}": counter for name, counter in counters.tensors().items()}
    return found


def test_a_step_of_several_views_is_the_cpu_s_and_the_same_bits_twice(
    webgpu: WebGpuRenderer, tmp_path: Path
) -> None:
    expected = step_of_several(CpuRenderer(threads=1), tmp_path)
    found, again = (step_of_several(webgpu, tmp_path) for _ in range(2))
    assert found.keys() == expected.keys() and "visits 2" in found
    errors = {name: relative(found[name], value) for name, value in expected.items()}
    assert {name: error for name, error in errors.items() if not error <= TIGHT} == {}
    assert [name for name, value in found.items() if not torch.equal(again[name], value)] == []


def test_the_long_check_of_a_step_passes_after_some_steps(webgpu: WebGpuRenderer) -> None:
    odd = Odd("", 60, (16, 16))
    state = trained_state(tiny_scene(size=odd.size, points=odd.anchors), odd.config(), webgpu, 4)
    assert check_step("step", state, twin_of(state, CpuRenderer(threads=1))).failed == []


class Curve(Silent):
    def __init__(self) -> None:
        self.losses: list[float] = []

    def on_step(self, info: StepInfo) -> None:
        self.losses.append(info.loss)


def short_config(steps: int, levels: int) -> Config:
    train = (("weight_average", 0.3), ("reduced_until", (0.4,)))
    config = Odd("", 0, (0, 0), replace(PLAIN, residual=8), train).config()
    joint = replace(PLAIN_JOINT, steps=levels, keep=(0.5,), weights="tied", prune_share=0.004)
    return replace(config, train=replace(config.train, steps=steps), levels=joint)


def trained(
    config: Config, renderer: Renderer, folder: Path, stop: int = 0, every: int = 0
) -> tuple[TrainState, list[float]]:
    """A whole training; `stop`: ended after so many steps, then resumed from its checkpoint."""
    folder.mkdir()
    scene = tiny_scene(size=(16, 16), points=50)  # one tile: a driver on the CPU takes its time
    context, curve = TrainContext(scene, config, renderer), Curve()
    state = open_state(context, folder, Silent())
    state.losses.read_every = every or state.losses.read_every
    left = iter(range(stop - 1, -1, -1))
    if not run_training(state, folder, curve, lambda: bool(stop) and next(left) == 0):
        state = open_state(context, folder, Silent())
        assert run_training(state, folder, curve, lambda: False)
    return state, curve.losses


def test_the_curve_of_100_steps_is_the_cpu_s_within_1_percent(
    webgpu: WebGpuRenderer, tmp_path: Path
) -> None:
    config = short_config(92, 8)
    # Steps alone: where growth begins, a seed more or less is a matter of rounding.
    growth = replace(config.train.growth, until=0.0)
    config = replace(config, train=replace(config.train, growth=growth))
    _, expected = trained(config, CpuRenderer(threads=1), tmp_path / "cpu", every=1)
    _, found = trained(config, webgpu, tmp_path / "webgpu", every=1)
    assert len(found) == len(expected) == 100
    assert max(abs(a / b - 1) for a, b in zip(found, expected, strict=True)) < 0.01


@pytest.mark.parametrize("batch", [1, 2])
def test_trainings_that_were_killed_are_the_same_bits_as_one_that_was_not(
    batch: int, webgpu: WebGpuRenderer, tmp_path: Path
) -> None:
    config = short_config(8, 3)
    config = replace(config, train=replace(config.train, batch=batch))
    first, _ = trained(config, webgpu, tmp_path / "first")
    for name, stop in (("killed", 5), ("killed among levels", 10)):
        other, _ = trained(config, webgpu, tmp_path / name, stop)
        expected, found = first.model.state_dict(), other.model.state_dict()
        assert found.keys() == expected.keys()
        assert [n for n, value in expected.items() if not torch.equal(found[n], value)] == [], name


MISSING: dict[str, Callable[[Config], Config]] = {
    "a fusion MLP": lambda c: replace(c, model=replace(TINY_MODEL, fusion="mlp")),
    "levels one after the other": lambda c: replace(
        c, levels=tiny_config(mode="sequential").levels
    ),
}


@pytest.mark.parametrize("reason", MISSING)
def test_where_a_kernel_is_missing_images_alone_are_the_device_s_and_it_is_said(
    reason: str, webgpu: WebGpuRenderer, tmp_path: Path
) -> None:
    config = MISSING[reason](short_config(2, 1))
    context = TrainContext(tiny_scene(), config, webgpu, device="webgpu")
    assert device_lines(context)[1].endswith(f"because of {reason}")
    state = open_state(context, tmp_path, Silent())
    assert state.whole is None
    if reason != "levels one after the other":
        assert run_training(state, tmp_path, Silent(), lambda: False)
        assert state.progress.loss > 0


def test_several_processes_are_left_to_the_host(webgpu: WebGpuRenderer) -> None:
    two = replace(short_config(2, 1), train=replace(short_config(2, 1).train, batch=2))
    context = TrainContext(tiny_scene(), two, webgpu, group=ProcessGroup(1, 2))
    assert left_to_host(context) == "several processes"
    assert left_to_host(replace(context, group=ProcessGroup())) == ""


class Messages(Silent):
    def __init__(self) -> None:
        self.texts: list[str] = []

    def on_message(self, text: str) -> None:
        self.texts.append(text)


@pytest.mark.slow
def test_a_whole_training_says_what_took_it_and_writes_a_file_that_opens(
    webgpu: WebGpuRenderer, small_room: Path, tmp_path: Path
) -> None:
    heard, settings = Messages(), {"levels.steps": 2, "levels.keep": (0.5,)}
    settings |= {"levels.coding_loss": 0, "levels.prune_share": 0, "train.exposure": "off"}
    run = gs.train(
        small_room,
        out=tmp_path / "run",
        observer=heard,
        steps=3,
        scale=4,
        settings=settings,
        device=f"webgpu:{webgpu.gpu.adapter.name}",
        evaluate=False,
    )
    told = [text for text in heard.texts if text.startswith("device:")]
    assert len(told) == 1 and "asked for; its test: image" in told[0]
    with run.open() as file:
        pictures = [np.asarray(file.render(0, renderer=r), np.int16) for r in ("cpu", "webgpu")]
    assert np.ptp(pictures[0]) > 0 and np.abs(pictures[0] - pictures[1]).max() <= 1
