"""State of a training: model, optimizer, random generators and progress.

Data alone; what happens to it stands in `step.py`, `view_step.py` and the phases.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, TypeAlias

import numpy as np
import torch
from msgspec import Meta
from torch import Tensor, nn

from gsynopsis.errors import DivergedError
from gsynopsis.model.anchors import AnchorModel
from gsynopsis.model.build import new_model
from gsynopsis.model.levels import tie_weights
from gsynopsis.scene.camera import STILL, Shift
from gsynopsis.training.context import TrainContext
from gsynopsis.training.device_photos import DevicePhotos
from gsynopsis.training.growth import GrowthStatistics
from gsynopsis.training.observer import Observer, Silent
from gsynopsis.training.optim.adam import Optimizer
from gsynopsis.training.passes import MakePass, choose_pass
from gsynopsis.training.regularize.exposure import Exposures
from gsynopsis.training.regularize.jitter import shift_places, subpixels_of
from gsynopsis.training.webgpu.choose import whole_step
from gsynopsis.training.whole_step import WholeStep

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
    coverage_cell: Count = 0
    """Side of the cells by which the coarsest level was first ranked, voxels; 0: not yet."""
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
    """Losses that were not read yet; see `step.py`.

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
        make_pass: Decodes and renders a view, natively or by autograd as model and renderer allow.
        whole: Whole steps on a device of their own; None: all are made of `make_pass`.
        losses: Losses still on the device.
        mask_logits: [N, K] while a mask is learnt, else [0].
        background: Color behind everything, [3]; see `view_step.background_of`.
        shifts: Places of a pixel at which steps sample photos, see `shift_places`.
        photos: Photos of a GPU training, uploaded ahead; None on the CPU.
        progress: Position of the run.
        optimizer: Of the phase; without parameters before the first one.
        moments: The optimizer's tensors from a checkpoint, until the phase makes its optimizer.
        checkpoint: File that this state was read from; None: a fresh one.
        statistics: Growth counters, one per view of a batch in this process; empty after growth.
        observer: Hears of passes over views.
        jitter: Sub-pixel jitter of this step's photos and views.
        factor: This step's photos are divided by this, see `reduced_factor`.
        exposures: Gains of the photos where they are solved, else None.
    """

    context: TrainContext
    model: AnchorModel
    generator: torch.Generator
    rng: np.random.Generator
    make_pass: MakePass
    whole: WholeStep | None
    losses: LossLog
    mask_logits: nn.Parameter
    background: Tensor
    shifts: list[Shift]
    photos: DevicePhotos | None
    progress: Progress = field(default_factory=Progress)
    optimizer: Optimizer = field(default_factory=lambda: Optimizer({}, {}))
    moments: dict[str, Tensor] = field(default_factory=dict[str, Tensor])
    checkpoint: Path | None = None
    statistics: list[GrowthStatistics] = field(default_factory=list[GrowthStatistics])
    observer: Observer = field(default_factory=Silent)
    jitter: Shift = STILL
    factor: float = 1.0
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
        make_pass=choose_pass(context.renderer, model),
        whole=whole,
        losses=LossLog(READ_EVERY if device.type == "cuda" or whole else 1),
        mask_logits=no_logits(device),
        background=torch.zeros(3, device=device),
        shifts=shift_places(subpixels_of(context.config)),
        factor=context.config.scale,
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
    bring_home(state)
    state.model = _on_device(state.context, model)
    state.make_pass = choose_pass(state.context.renderer, state.model)


def bring_home(state: TrainState) -> None:
    """Give the host's tensors a device's values, before anything reads or changes them."""
    if state.whole is not None:
        state.whole.home()


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


def no_logits(device: torch.device) -> nn.Parameter:
    """Mask logits where no mask is learnt, [0]."""
    return nn.Parameter(torch.zeros(0, device=device))
