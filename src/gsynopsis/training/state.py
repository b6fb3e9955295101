"""State of a training: model, optimizer, random generators and progress.

Data alone; what happens to it stands in `view_step.py`, `view_order.py`, `loss_log.py` and the
phases.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, TypeAlias

import numpy as np
import torch
from msgspec import Meta
from torch import Tensor, nn

from gsynopsis.errors import DivergedError
from gsynopsis.model.anchors import ROW_PARAMETERS, AnchorModel
from gsynopsis.model.build import new_model
from gsynopsis.model.levels import tie_weights
from gsynopsis.scene.camera import STILL, Shift
from gsynopsis.training.context import TrainContext
from gsynopsis.training.device_photos import DevicePhotos
from gsynopsis.training.growth import GrowthStatistics
from gsynopsis.training.observer import Observer, Silent
from gsynopsis.training.optim.adam import Optimizer
from gsynopsis.training.passes import Passes, choose_passes
from gsynopsis.training.regularize.exposure import Exposures
from gsynopsis.training.regularize.jitter import subpixels_of
from gsynopsis.training.webgpu.choose import whole_step

READ_EVERY = 50
"""Steps after which a GPU's losses are read: a host that reads one waits for all before it."""
Count: TypeAlias = Annotated[int, Meta(ge=0, le=2**62)]
Seconds: TypeAlias = Annotated[float, Meta(ge=0, le=1e12)]
Mean: TypeAlias = Annotated[float, Meta(ge=-1e30, le=1e30)]
"""Ranges that a checkpoint's numbers are checked against."""


@dataclass
class Progress:
    """Position of a run: everything small that a checkpoint keeps as JSON."""

    phase: Count = 0
    begun: bool = False
    """The phase has prepared the model; steps may be done."""
    step: Count = 0
    order: list[Count] = field(default_factory=list[int])
    """Training views still to come before they are shuffled again."""
    seconds: Seconds = 0.0
    """Training time so far."""
    phase_seconds: dict[str, Seconds] = field(default_factory=dict[str, float])
    """Training time of each finished phase, by its name."""
    loss: Mean = 0.0
    error: Mean = 0.0
    """Smoothed mean squared error, for the PSNR on display."""
    sparsity: Mean = 0.0
    """λ_s of the controller while masks are learnt."""
    trained_bytes: list[list[Count]] | None = None
    """Sizes before rounding, see `SizeModel.trained`; None: nothing was rounded."""

    @property
    def psnr(self) -> float:
        """Smoothed training PSNR, dB."""
        return float(-10 * np.log10(max(self.error, 1e-10)))


@dataclass(frozen=True)
class PendingLoss:
    """Losses of one step that are still on the device.

    Attributes:
        step: Number of the step, from 1.
        views: View of each image.
        values: Loss and squared error of each image, float64 [P, 2]; the loss is not finite where
            an opacity is not.
    """

    step: int
    views: tuple[int, ...]
    values: Tensor


@dataclass
class LossLog:
    """Losses that were not read yet; see `loss_log.py`.

    Attributes:
        read_every: Steps whose losses are read together: one on the CPU, where each is checked
            before anything follows from it.
        pending: Losses of whole steps.
        of_view: Loss and squared error, [2], of each image of the view that is being trained, in a
            batch of several views.
        failures: Views of this batch that diverged; raised once all processes know.
    """

    read_every: int
    pending: list[PendingLoss] = field(default_factory=list[PendingLoss])
    of_view: list[Tensor] = field(default_factory=list[Tensor])
    failures: list[DivergedError] = field(default_factory=list[DivergedError])


@dataclass
class TrainState:
    """Everything of a training that changes; made by `new_state`, `fresh_state` or `load_state`.

    Attributes:
        context: Scene, settings and machinery, which do not change.
        model: The anchor model, on the renderer's device.
        generator: Initial values of the model, randomness of growth.
        rng: Order of views, sub-pixel jitter, levels of a step.
        passes: Native or autograd decoding and rendering, as model and renderer allow, or whole
            steps on a device.
        losses: Losses still on the device.
        mask_logits: [N, K] while a mask is learnt, else [0].
        background: Color behind everything, [3]; see `background_of`.
        subpixels: Places of a pixel along each axis at which steps sample photos.
        photos: Photos of a GPU training, uploaded ahead; None on the CPU.
        progress: Position of the run.
        optimizer: Of the phase; without parameters before the first one.
        moments: The optimizer's tensors from a checkpoint, until the phase makes its optimizer.
        checkpoint: File that this state was read from; None: a fresh one.
        statistics: Growth counters, one per view of a batch in this process; empty after growth.
        observer: Hears of passes over views.
        jitter: Sub-pixel jitter of this step's photos and views.
        exposures: Gains of the photos where they are solved, else None.
    """

    context: TrainContext
    model: AnchorModel
    generator: torch.Generator
    rng: np.random.Generator
    passes: Passes
    losses: LossLog
    mask_logits: nn.Parameter
    background: Tensor
    subpixels: int
    photos: DevicePhotos | None
    progress: Progress = field(default_factory=Progress)
    optimizer: Optimizer = field(default_factory=lambda: Optimizer({}, {}))
    moments: dict[str, Tensor] = field(default_factory=dict[str, Tensor])
    checkpoint: Path | None = None
    statistics: list[GrowthStatistics] = field(default_factory=list[GrowthStatistics])
    observer: Observer = field(default_factory=Silent)
    jitter: Shift = STILL
    exposures: Exposures | None = None


def new_state(
    context: TrainContext,
    model: AnchorModel,
    generator: torch.Generator,
    rng: np.random.Generator,
) -> TrainState:
    """A training that has done no step, of a model that is there."""
    device = context.renderer.device
    model, whole = _on_device(context, model), whole_step(context)
    return TrainState(
        context=context,
        model=model,
        generator=generator,
        rng=rng,
        passes=choose_passes(context.renderer, model, whole),
        losses=LossLog(READ_EVERY if device.type == "cuda" or whole else 1),
        mask_logits=no_logits(device),
        background=torch.zeros(3, device=device),
        subpixels=subpixels_of(context.config),
        photos=DevicePhotos(context.scene, device) if device.type == "cuda" else None,
    )


def fresh_state(context: TrainContext) -> TrainState:
    """A training before its first step; the same seed gives the same run.

    Raises:
        SceneError: the scene has no point to begin with.
    """
    seed = context.config.train.seed
    generator = torch.Generator().manual_seed(seed)
    model = new_model(context.scene, context.config.model, generator)
    state = new_state(context, model, generator, np.random.default_rng(seed))
    if context.config.train.exposure == "on":
        state.exposures = Exposures.identity(context.scene.train, context.renderer.device)
    return state


def set_model(state: TrainState, model: AnchorModel) -> None:
    """Continue with another model, on the renderer's device; tied weights are tied again."""
    state.passes.home()
    state.model = _on_device(state.context, model)
    state.passes = choose_passes(state.context.renderer, state.model, state.passes.whole)


def _on_device(context: TrainContext, model: AnchorModel) -> AnchorModel:
    model = model.to(context.renderer.device)
    if context.config.levels.tied:
        tie_weights(model)
    return model


def set_optimizer(state: TrainState, optimizer: Optimizer) -> None:
    """Optimize these parameters from now on, with the moments of a checkpoint if it has any.

    Only what the optimizer moves has gradients, starting from none.
    """
    state.optimizer = optimizer
    trained = {id(p) for p in optimizer.parameters()}
    for parameter in state.model.parameters():
        parameter.requires_grad_(id(parameter) in trained)
        parameter.grad = None
    optimizer.load(state.moments, state.checkpoint)
    state.moments = {}


def background_of(state: TrainState, view: int) -> Tensor:
    """Color behind everything in a view, [3]: white in every other one if photos have an alpha."""
    return (
        state.background + 1 if state.context.alpha is not None and view % 2 else state.background
    )


def trainable_anchors(state: TrainState) -> Tensor | None:
    """Anchors inside the trained region, bool [N]; None: all of them."""
    region = state.context.region
    return None if region is None else region.holds(state.model.placed()[0])


def optimizer_step(state: TrainState) -> None:
    """Move the trainable anchors by their gradients, which are dropped."""
    trainable = trainable_anchors(state)
    if trainable is not None:
        # Adam leaves in place, to the bit, what never had a gradient.
        for name in ROW_PARAMETERS:
            grad = getattr(state.model, name).grad
            if grad is not None:
                grad[~trainable] = 0
    state.passes.move(state.optimizer)


def no_logits(device: torch.device) -> nn.Parameter:
    """Mask logits where no mask is learnt, [0]."""
    return nn.Parameter(torch.zeros(0, device=device))
