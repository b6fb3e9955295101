"""One training step on a device beside the CPU's: loss, gradients, growth statistics, time by part.

The model is trained on the device first, so that what is compared is what training meets: opaque
Gaussians, long ones, thousands in a pixel's way.
"""

import copy
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from statistics import median

import torch
from torch import Tensor

from gsynopsis.config import Config
from gsynopsis.model.anchors import AnchorModel
from gsynopsis.render.base import Renderer
from gsynopsis.scene.camera import STILL
from gsynopsis.scene.scene import Scene
from gsynopsis.selftest.findings import Finding, distance, judged
from gsynopsis.training.context import TrainContext
from gsynopsis.training.growth import GrowthStatistics
from gsynopsis.training.losses import SSIM_WEIGHT
from gsynopsis.training.passes import AutogradPass
from gsynopsis.training.phases.full import FullPhase
from gsynopsis.training.state import TrainState, bring_home, fresh_state, set_model, set_optimizer
from gsynopsis.training.step import optimizer_step
from gsynopsis.training.view_step import (
    background_of,
    count_view,
    forward_view,
    load_target,
    photometric_loss,
    view_job,
    volume_loss,
)

LIMITS = {"image": 2e-3, "loss": 2e-3, "gradient": 0.01, "statistics": 0.02}
"""The largest error that passes: root mean square of the image, and lengths of errors relative to
what is expected. gsplat caps alpha at 0.999 where the CPU does at 0.99, and rounding decides at
every cut-off, so a trained model's image differs a little. On paper: no card was at hand yet."""
VIEWS = 3
"""Views of a step that are compared."""


@dataclass(frozen=True)
class StepTimes:
    """Milliseconds of a training step.

    Attributes:
        anchors: Of the model.
        gaussians: Drawn in the view.
        whole: Median of a step as training does it.
        parts: Median of each part, the device awaited after each: their sum is over `whole`.
        memory: Most memory that tensors took on the device, bytes; 0 on the CPU.
    """

    anchors: int
    gaussians: int
    whole: float
    parts: dict[str, float]
    memory: int


def trained_state(scene: Scene, config: Config, renderer: Renderer, steps: int) -> TrainState:
    """A full training after some steps, ready for the next."""
    state = fresh_state(TrainContext(scene, config, renderer))
    phase = _phase(config)
    phase.begin(state)
    set_optimizer(state, phase.make_optimizer(state))
    for _ in range(steps):
        phase.step(state)
        state.progress.step += 1
    return state


def twin_of(state: TrainState, renderer: Renderer) -> TrainState:
    """The same model, before the same step, on another renderer's device."""
    bring_home(state)
    other = fresh_state(TrainContext(state.context.scene, state.context.config, renderer))
    other.progress = copy.deepcopy(state.progress)  # decides dropout, and what is in the loss
    set_model(other, copy.deepcopy(state.model).to(renderer.device))
    _count_anew(other)
    return other


def check_step(name: str, found: TrainState, oracle: TrainState) -> Finding:
    """The errors of one step's views against an oracle with the same model; gradients add up."""
    errors = {"image": 0.0, "loss": 0.0}
    sides = [found, oracle]
    for state in sides:
        _count_anew(state)
        state.jitter = STILL  # the last step's was drawn by chance
    views = found.context.scene.train[:VIEWS]
    for view in views:
        image, true_image = (_image(state, view) for state in sides)
        error = float((image - true_image).square().mean().sqrt())
        errors["image"] = max(errors["image"], error)
    for view in views:
        loss, true_loss = (_observed(state, view) for state in sides)
        errors["loss"] = max(errors["loss"], abs(loss - true_loss) / max(true_loss, 1e-12))
    expected = dict(oracle.model.named_parameters())
    for key, parameter in found.model.named_parameters():
        truth, whole = expected[key].grad, found.whole
        grad = parameter.grad if whole is None else whole.gradient(parameter)
        if grad is not None and truth is not None:
            errors[f"{key}.gradient"] = distance(grad, truth)
    bring_home(found)
    for key, counter in found.statistics[0].tensors().items():
        errors[f"{key}.statistics"] = distance(counter, oracle.statistics[0].tensors()[key])
    return judged(name, errors, LIMITS)


def time_step(state: TrainState, rounds: int) -> StepTimes:
    """Milliseconds of a step, whole and by part; the model moves on."""
    phase, device = _phase(state.context.config), state.context.renderer.device
    if device.type == "cuda":
        torch.cuda.reset_peak_memory_stats(device)
    whole = [_milliseconds(lambda: _step(phase, state), device) for _ in range(rounds + 1)][1:]
    parts: dict[str, list[float]] = {}
    gaussians = 0
    # Whole steps elsewhere have no parts that the host could time.
    for number in range(rounds + 1 if state.whole is None else 0):
        times, gaussians = _parts(state, state.context.scene.train[number % VIEWS])
        if number:  # the first one warms up
            for part, ms in times.items():
                parts.setdefault(part, []).append(ms)
    memory = torch.cuda.max_memory_allocated(device) if device.type == "cuda" else 0
    medians = {part: round(median(values), 3) for part, values in parts.items()}
    return StepTimes(len(state.model), gaussians, round(median(whole), 3), medians, memory)


def _parts(state: TrainState, view: int) -> tuple[dict[str, float], int]:
    """Milliseconds of each part of a view's step and of the optimizer, and Gaussians drawn.

    The same calls as training's, by autograd on either device; the loss without its exposure and
    masks, which the scene of the check has not.
    """
    context, model = state.context, state.model
    times: dict[str, float] = {}
    device, last = context.renderer.device, [0.0]

    def lap(part: str) -> None:
        now = _clock(device)
        if part:
            times[part] = 1e3 * (now - last[0])
        last[0] = _clock(device)

    camera = context.scene.camera(view, context.config.scale)
    lap("")
    photo = load_target(state, view, context.config.scale)
    lap("photo")
    passed = AutogradPass(model, context.renderer, model.part(-1), camera)
    gaussians = passed.decoded.gaussians
    lap("culling, heads, assembly")
    rendering = passed.render(None, background_of(state, view))
    lap("rasterizer")
    loss = photometric_loss(rendering.image, photo, SSIM_WEIGHT) + volume_loss(gaussians.scales)
    lap("loss")
    (pull,) = torch.autograd.grad(loss, rendering.image, retain_graph=True)
    lap("loss, backward")
    drawn = [gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities]
    drawn.append(gaussians.colors)
    grads = torch.autograd.grad(rendering.image, drawn, pull, retain_graph=True)
    lap("rasterizer, backward")
    torch.autograd.backward(drawn, list(grads))
    lap("heads, assembly, backward")
    # The centres' gradient is left on them by `backward` alone: zeros cost the same to count.
    zeros = torch.zeros(len(gaussians), 2, device=device)
    count_view(state.statistics[0], passed.decoded, replace(rendering, screen_grad=lambda: zeros))
    lap("growth statistics")
    optimizer_step(state)
    lap("Adam")
    return times, len(gaussians)


def _image(state: TrainState, view: int) -> Tensor:
    """The image of a view, on the CPU."""
    scale = state.context.config.scale
    with torch.no_grad():
        result = forward_view(state, state.model.part(-1), view, scale)[0]
    return result.rendering.image.detach().cpu()


def _observed(state: TrainState, view: int) -> float:
    """The loss of a view; gradients and statistics are added up."""
    part, scale, counters = state.model.part(-1), state.context.config.scale, state.statistics[0]
    whole = state.whole
    if whole is not None:
        values = whole.train_view(view_job(state, part, view, scale, 1.0, counters))
        whole.settle()
        return float(values[0])
    result, passed = forward_view(state, part, view, scale)
    passed.backward(result.loss)
    count_view(counters, result.decoded, result.rendering)
    return float(result.loss.detach())


def _step(phase: FullPhase, state: TrainState) -> None:
    phase.step(state)
    if state.whole is not None:
        state.whole.settle()  # waits for the device


def _count_anew(state: TrainState) -> None:
    """No gradients, no statistics, the optimizer of a full training."""
    model: AnchorModel = state.model
    device = state.context.renderer.device
    state.statistics = [GrowthStatistics.zeros(len(model), model.slots, device)]
    set_optimizer(state, _phase(state.context.config).make_optimizer(state))


def _phase(config: Config) -> FullPhase:
    return FullPhase(config.train.steps, config.train.steps + config.levels.steps)


def _milliseconds(work: Callable[[], object], device: torch.device) -> float:
    start = _clock(device)
    work()
    return 1e3 * (_clock(device) - start)


def _clock(device: torch.device) -> float:
    """Seconds, when the device has done all that was asked of it."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    return time.perf_counter()
