"""State of a training in memory, and the forward and backward passes that all phases share."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, TypeAlias

import numpy as np
import torch
from msgspec import Meta
from torch import Tensor, nn

from gsynopsis.config import RATES, Config, RateConfig
from gsynopsis.errors import DivergedError, PeerError
from gsynopsis.model.anchors import (
    ROW_PARAMETERS,
    AnchorModel,
    Decoded,
    LearntMask,
    LevelPart,
)
from gsynopsis.model.build import new_model
from gsynopsis.model.levels import tie_weights
from gsynopsis.render.base import Gaussians, Renderer, Rendering
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import STILL, Shift
from gsynopsis.scene.scene import Scene
from gsynopsis.training.device_photos import DevicePhotos, Mask
from gsynopsis.training.distributed.gradient_sync import (
    gradients_there,
    pack_gradients,
    sum_gradients,
    unpack_gradients,
)
from gsynopsis.training.distributed.process_group import World, pairwise_sum
from gsynopsis.training.growth import GrowthStatistics
from gsynopsis.training.levels.size_budget import Packer
from gsynopsis.training.losses import (
    mean_squared_error,
    photometric_loss,
    unit_pixels,
    volume_loss,
)
from gsynopsis.training.observer import Observer, Silent
from gsynopsis.training.optim.adam import Optimiser
from gsynopsis.training.regularize.dropout import dropout_factors
from gsynopsis.training.regularize.exposure import WARM_UP, Exposures, unsaturated
from gsynopsis.training.regularize.jitter import draw_jitter, jitter_of, places
from gsynopsis.training.sub_scene import Region

SSIM_WEIGHT = 0.2
"""λ_SSIM of (1 − λ)·L1 + λ·(1 − SSIM) (paper)."""
VOLUME_WEIGHT = 0.001
"""λ_vol on the mean product of scales (paper)."""
LEAST_SHARE = 0.01
"""Of a photo; what a smaller mask shows does not count more."""
SMOOTHING = 0.98
"""Weight of the past in the loss and PSNR that are shown, about 50 steps."""
READ_EVERY = 50
"""Steps after which a GPU's losses are read: a host that reads one waits for all before it."""

Count: TypeAlias = Annotated[int, Meta(ge=0, le=2**62)]
Seconds: TypeAlias = Annotated[float, Meta(ge=0, le=1e12)]
Mean: TypeAlias = Annotated[float, Meta(ge=-1e30, le=1e30)]
"""What a checkpoint may say."""


@dataclass(frozen=True)
class Setup:
    """What a training is given; nothing in it changes.

    Attributes:
        scene: Photos, cameras and points.
        config: Settings.
        renderer: Its device is the training's.
        packer: The file format; without it sizes cannot be ordered, nor values rounded.
        world: This process among those that train together; its size divides `train.batch`.
        region: The anchors inside are trained and all else stays, networks too; None: all.
    """

    scene: Scene
    config: Config
    renderer: Renderer
    packer: Packer | None = None
    world: World = field(default_factory=World)
    region: Region | None = None

    @property
    def rates(self) -> RateConfig:
        """The table of learning rates."""
        return RATES[self.config.train.rates]


@dataclass
class Cursor:
    """Where a run stands: everything small that a checkpoint keeps as JSON."""

    phase: Count = 0
    begun: bool = False
    """The phase has prepared the model; steps may be done."""
    step: Count = 0
    order: list[Count] = field(default_factory=list[int])
    """Training views still to come before they are shuffled again."""
    seconds: Seconds = 0.0
    """Training time so far."""
    phase_seconds: dict[str, Seconds] = field(default_factory=dict[str, float])
    """Of it, what each finished phase took, by its name."""
    loss: Mean = 0.0
    error: Mean = 0.0
    """Smoothed mean squared error, for the PSNR that is shown."""
    sparsity: Mean = 0.0
    """λ_s of the controller while masks are learnt."""
    trained_bytes: list[list[Count]] | None = None
    """Sizes of what training left before it was rounded, see `Packer.trained`; None: it was not."""


@dataclass(frozen=True)
class Outcome:
    """One forward pass: the photometric loss, still attached, and what was rendered.

    `error` is the mean squared error over what counts of the photo, float64 [].
    """

    loss: Tensor
    decoded: Decoded
    rendering: Rendering
    error: Tensor


@dataclass(frozen=True)
class Unread:
    """Losses that a step has found and nobody has read yet.

    Attributes:
        step: Its number, from 1.
        views: The view of each image.
        values: Loss and squared error of each image, on the device, [P, 2]; the loss is not finite
            where an opacity is not.
    """

    step: int
    views: tuple[int, ...]
    values: Tensor


class TrainState:
    """Everything of a training that changes: model, optimiser, random states and cursor.

    Attributes:
        setup: What the training was given.
        model: The anchor model, on the renderer's device.
        cursor: Where the run stands.
        rng: Order of views, sub-pixel jitter, levels of a step.
        generator: First values of the model, luck of growth.
        optimiser: Of the phase; without parameters before the first one.
        moments: The optimiser's tensors from a checkpoint, until the phase makes its optimiser.
        checkpoint: Whose state this was, if it was not a fresh one.
        statistics: One per view of a batch that this process works on, while growing; else none.
        mask_logits: [N, K] while a mask is learnt, else [0].
        background: Colour behind everything, [3].
        observer: Told of passes over views.
        exposures: Gains of the photos where they are solved, else None.
        subpixels: Places of a pixel along each axis at which steps sample photos.
        jitter: Sub-pixel jitter of this step's photos and views.
        photos: Those on a GPU, brought there ahead; None where the device is the CPU.
        read_every: Steps whose losses are read together: one on the CPU, where each is checked
            before anything follows from it.
    """

    def __init__(
        self,
        setup: Setup,
        model: AnchorModel,
        generator: torch.Generator,
        rng: np.random.Generator,
    ) -> None:
        """A training that has done no step; see `fresh_state` and `checkpoint.load_state`."""
        self.setup, self.generator, self.rng = setup, generator, rng
        self.cursor = Cursor()
        self.optimiser = Optimiser({}, {})
        self.moments: dict[str, Tensor] = {}
        self.checkpoint: Path | None = None
        self.statistics: list[GrowthStatistics] = []
        self.mask_logits = no_logits(setup.renderer.device)
        self.background = torch.zeros(3, device=setup.renderer.device)
        self.observer: Observer = Silent()
        self.subpixels = jitter_of(setup.config)
        self.jitter = STILL
        self.exposures: Exposures | None = None
        on_gpu = setup.renderer.device.type == "cuda"
        self.photos = DevicePhotos(setup.scene, setup.renderer.device) if on_gpu else None
        self.read_every = READ_EVERY if on_gpu else 1
        self._unread: list[Unread] = []
        self._shown: list[Tensor] = []
        self._failures: list[DivergedError] = []
        self.adopt(model)

    def adopt(self, model: AnchorModel) -> None:
        """Go on with a model, on the renderer's device; tied weights become the same again."""
        self.model = model.to(self.setup.renderer.device)
        if self.setup.config.levels.tied:
            tie_weights(model)

    def start(self, optimiser: Optimiser) -> None:
        """Optimise these parameters from now on, with the moments of a checkpoint if it has any.

        Gradients are for what the optimiser moves and for nothing else, starting from none.
        """
        self.optimiser = optimiser
        moving = {id(p) for p in optimiser.parameters()}
        for parameter in self.model.parameters():
            parameter.requires_grad_(id(parameter) in moving)
            parameter.grad = None
        optimiser.load(self.moments, self.checkpoint)
        self.moments = {}

    def moving(self) -> Tensor | None:
        """Anchors that this training moves, bool [N]; None: all of them."""
        region = self.setup.region
        return None if region is None else region.holds(self.model.placed()[0])

    def move(self) -> None:
        """A step of the optimiser, for the anchors that this training moves."""
        moving = self.moving()
        if moving is not None:
            # Adam leaves in place, to the bit, what never had a gradient.
            for name in ROW_PARAMETERS:
                grad = getattr(self.model, name).grad
                if grad is not None:
                    grad[~moving] = 0
        self.optimiser.step()

    def next_view(self) -> int:
        """A training view, without replacement until all were seen (methods.md §1.7)."""
        train = self.setup.scene.train
        if not self.cursor.order:
            self.cursor.order = [train[i] for i in self.rng.permutation(len(train))]
        view = self.cursor.order.pop()
        if self.cursor.order:
            scale = self.setup.config.scale
            ahead = self.setup.scene if self.photos is None else self.photos
            ahead.expect(self.cursor.order[-1], scale, places(self.subpixels))
        return view

    def next_views(self) -> list[int]:
        """The `train.batch` views of a step; draws their jitter. Alike in every process."""
        if self.subpixels > 1:
            self.jitter = draw_jitter(self.rng, self.subpixels)
        return [self.next_view() for _ in range(self.setup.config.train.batch)]

    def batch(self, views: Sequence[int]) -> Iterator[int]:
        """This process's share of a step's views; learn from each before asking for the next.

        At the end the gradient of every parameter is the mean over all views of all processes,
        and it is the same, bit for bit, for one process and for two.

        Raises:
            DivergedError: see `learn`.
            PeerError: another process stopped.
        """
        if len(views) == 1:
            yield views[0]
            return
        world, device = self.setup.world, self.setup.renderer.device
        parameters, own, buffers = self.optimiser.parameters(), world.share(views), []
        there = [False] * len(parameters)
        for place, view in enumerate(own):
            self._shown = []
            yield view
            shown = torch.zeros(len(views), len(self._shown), 2, device=device)
            shown[world.rank * len(own) + place] = torch.stack(self._shown)
            there = [a or b for a, b in zip(there, gradients_there(parameters), strict=True)]
            buffers.append(pack_gradients(parameters, shown))
        total = sum_gradients(world, pairwise_sum(buffers), parameters)
        known = there if world.size == 1 else None
        shown = unpack_gradients(total, parameters, len(views), known)
        if self._failures:
            raise self._failures[0]
        each = len(shown) // len(views)
        self._note(tuple(view for view in views for _ in range(each)), shown)

    def sum_over(
        self, what: str, views: Sequence[int], size: int, add: Callable[[int, Tensor], None]
    ) -> Tensor:
        """A float32 [size] tensor that every view of all processes adds to.

        Summed as gradients are, each place of the batch its own views and then the places: so it is
        the same, bit for bit, for one process and for two.

        Args:
            what: It is, for people.
            views: Of the scene.
            size: Of the tensor.
            add: Adds a view's share to what it is given.
        """
        batch, world, totals = self.setup.config.train.batch, self.setup.world, list[Tensor]()
        self.read_losses()
        shares = [views[place::batch] for place in world.share(range(batch))]
        done, count = 0, sum(map(len, shares))
        for share in shares:
            total = torch.zeros(size, device=self.setup.renderer.device)
            for view in share:
                add(view, total)
                done += 1
                self.observer.on_pass(what, done, count)
            totals.append(total)
        return world.sum(pairwise_sum(totals))

    def target(self, view: int, factor: float, jitter: Shift = STILL) -> Tensor:
        """A photo as float32 [H, W, 3] in [0, 1]."""
        if self.photos is not None:
            return unit_pixels(self.photos.get(view, factor, jitter))
        return unit_pixels(self.setup.scene.image(view, factor, jitter))

    def forward(
        self, part: LevelPart, view: int, factor: float, learnt: LearntMask | None = None
    ) -> Outcome:
        """Decode, render and compare one view at one level."""
        camera = self.setup.scene.camera(view, factor, self.jitter)
        decoded = self.model.decode_part(part, camera, learnt)
        drawn, _ = self._drawn(decoded.gaussians, view)
        rendering = self.setup.renderer.render(drawn, camera, self.background)
        return self._outcome(decoded, rendering, view, factor)

    def _drawn(self, gaussians: Gaussians, view: int) -> tuple[Gaussians, Tensor | None]:
        """What this step's image of a view draws, and factors on opacities [G]; None: all of it."""
        train, cursor = self.setup.config.train, self.cursor
        if not train.dropout:
            return gaussians, None
        key = (train.seed, cursor.phase, cursor.step, view)
        factors = dropout_factors(gaussians.opacities, train.dropout, key)
        return replace(gaussians, opacities=gaussians.opacities * factors), factors

    def _outcome(self, decoded: Decoded, rendering: Rendering, view: int, factor: float) -> Outcome:
        target = self.target(view, factor, self.jitter)
        image, share = self.compared(rendering.image, target, view, factor)
        loss = photometric_loss(image, target, SSIM_WEIGHT) / share
        loss = loss + self._volume_weight * volume_loss(decoded.gaussians.scales)
        weight = self.setup.config.train.opacity_weight
        if weight and self._grown and len(decoded.gaussians.opacities):
            loss = loss + weight * decoded.gaussians.opacities.mean()
        error = mean_squared_error(image, target) / share
        return Outcome(loss, decoded, rendering, error)

    def study(self, part: LevelPart, view: int, factor: float, weight: float = 1.0) -> Outcome:
        """Forward and backward pass of one view at one level; gradients add up in the parameters.

        Args:
            part: What is decoded; its masks are not learnt.
            view: Of the scene.
            factor: Reduction of its photo.
            weight: Of the loss.

        Raises:
            DivergedError: see `learn`.
        """
        renderer, model = self.setup.renderer, self.model
        if isinstance(renderer, CpuRenderer) and model.is_native(part):
            return self._study_natively(renderer, part, view, factor, weight)
        outcome = self.forward(part, view, factor)
        self.learn(outcome.loss * weight, outcome, view)
        return outcome

    def _study_natively(
        self, renderer: CpuRenderer, part: LevelPart, view: int, factor: float, weight: float
    ) -> Outcome:
        """`study` by native passes in order, which `forward` and `learn` equal bit for bit."""
        camera = self.setup.scene.camera(view, factor, self.jitter)
        with torch.no_grad():
            made = self.model.decode_pass(part, camera)
            gaussians = made.decoded.gaussians
            thinned, factors = self._drawn(gaussians, view)
            drawn = renderer.render_pass(thinned, camera, self.background)
        # Only what the loss is made of goes through autograd.
        loose = [drawn.image, gaussians.scales, gaussians.opacities]
        image, scales, opacities = (t.detach().requires_grad_(True) for t in loose)
        shown = replace(gaussians, scales=scales, opacities=opacities)
        outcome = self._outcome(
            replace(made.decoded, gaussians=shown),
            replace(drawn.rendering, image=image),
            view,
            factor,
        )
        self.learn(outcome.loss * weight, outcome, view)
        if image.grad is not None:
            grads = drawn.backward(image.grad)
            if factors is not None:
                grads[3].mul_(factors)
            for place, leaf in ((2, scales), (3, opacities)):
                if leaf.grad is not None:
                    grads[place] += leaf.grad
            made.backward(grads)
        return outcome

    def compared(
        self, image: Tensor, target: Tensor, view: int, factor: float
    ) -> tuple[Tensor, float]:
        """A rendering [H, W, 3] as it is compared with its photo, and the share that counts.

        In the photo's exposure, and outside of its mask the photo itself, so that nothing there is
        wrong.
        """
        found = self._mask(view, factor)
        if self.exposures is not None:
            if self._solves_exposures:
                self.exposures.solve(image, target, view, None if found is None else found[0])
            image = unsaturated(self.exposures.applied(image, view), target)
        if found is None:
            return image, 1.0
        mask, share = found
        return target + mask[:, :, None] * (image - target), max(share, LEAST_SHARE)

    def _mask(self, view: int, factor: float) -> Mask | None:
        scene = self.setup.scene
        if scene.reading.masks != "loss":
            return None
        if self.photos is not None:
            return self.photos.mask(view, factor, self.jitter)
        mask = scene.mask(view, factor, self.jitter)
        return None if mask is None else (torch.from_numpy(mask), float(mask.mean()))

    @property
    def _volume_weight(self) -> float:
        """λ_vol on volumes in world units, such that it is stated for the unit of the rates."""
        unit = self.setup.rates.unit_extent
        return VOLUME_WEIGHT * ((unit / self.model.frame.extent) ** 3 if unit else 1.0)

    @property
    def _grown(self) -> bool:
        """Anchors are neither added nor removed any more."""
        settings = self.setup.config.train
        return self.cursor.phase > 0 or self.cursor.step >= settings.growth.until * settings.steps

    @property
    def _solves_exposures(self) -> bool:
        """Renderings say how bright photos are; a block has the whole's gains."""
        warm = self.cursor.step >= WARM_UP * self.setup.config.train.steps
        return self.setup.region is None and (self.cursor.phase > 0 or warm)

    def learn(self, loss: Tensor, outcome: Outcome, view: int) -> None:
        """Backward pass and the shown averages; the optimiser step is the phase's business.

        Raises:
            DivergedError: the loss or an opacity is not finite. Nothing was changed, unless losses
                are read later, see `read_every`.
        """
        # A slot whose opacity is NaN is not rendered, so the loss alone would not tell.
        value = loss.detach() + 0 * outcome.decoded.opacity.detach().sum()
        shown = torch.stack([value.double(), outcome.error])
        if self.setup.config.train.batch == 1:
            self._note((view,), shown[None])
        else:
            self._shown.append(shown)
            if self.read_every == 1 and not bool(torch.isfinite(value)):
                # The other processes wait for this step's sum: it tells them.
                self._failures.append(self._diverged(self.cursor.step + 1, view, float(value)))
        if loss.requires_grad:  # nothing adapts while ablation `base` warms up
            loss.backward()

    def _note(self, views: tuple[int, ...], values: Tensor) -> None:
        """Losses and errors [P, 2] of a step; read where it is time, and where none is known."""
        self._unread.append(Unread(self.cursor.step + 1, views, values))
        steps = self.cursor.step + 1 - self._unread[0].step
        if steps >= self.read_every - 1 or self.cursor.loss == 0:
            self.read_losses()

    def read_losses(self) -> None:
        """Read the losses that nobody has read yet, all of them at once, and count them in.

        Raises:
            DivergedError: one is not finite.
            PeerError: so is one of another process's view.
        """
        unread, self._unread = self._unread, []
        if not unread:
            return
        values = torch.cat([one.values for one in unread]).tolist()
        labels = [(one, place) for one in unread for place in range(len(one.views))]
        for (one, place), (value, error) in zip(labels, values, strict=True):
            if not np.isfinite(value):
                if place not in self.setup.world.share(range(len(one.views))):
                    raise PeerError("another process of this training diverged; see its message")
                raise self._diverged(one.step, one.views[place], value)
            self._smooth(value, error)

    def _diverged(self, step: int, view: int, value: float) -> DivergedError:
        return DivergedError(
            f"step {step}: view {self.setup.scene.views[view].name} gives a loss of {value} or "
            f"opacities that are not all finite; first non-finite tensor: "
            f"{self.non_finite() or 'none'}; the last checkpoint is kept"
        )

    def _smooth(self, value: float, error: float) -> None:
        keep = 0.0 if self.cursor.loss == 0 else SMOOTHING
        self.cursor.loss = keep * self.cursor.loss + (1 - keep) * value
        self.cursor.error = keep * self.cursor.error + (1 - keep) * error

    @property
    def psnr(self) -> float:
        """Smoothed training PSNR, dB."""
        return float(-10 * np.log10(max(self.cursor.error, 1e-10)))

    def non_finite(self) -> str:
        """Name of the first parameter with a value that is not finite; empty if all are."""
        for name, parameter in self.model.named_parameters():
            if not bool(torch.isfinite(parameter).all()):
                return name
        return ""


def no_logits(device: torch.device) -> nn.Parameter:
    """Mask logits where no mask is learnt, [0]."""
    return nn.Parameter(torch.zeros(0, device=device))


def fresh_state(setup: Setup) -> TrainState:
    """A training before its first step; the same seed gives the same run.

    Raises:
        SceneError: the scene has no point to begin with.
    """
    seed = setup.config.train.seed
    generator = torch.Generator().manual_seed(seed)
    model = new_model(setup.scene, setup.config.model, generator)
    state = TrainState(setup, model, generator, np.random.default_rng(seed))
    if setup.config.train.exposure == "on":
        state.exposures = Exposures.identity(setup.scene.train, setup.renderer.device)
    return state
