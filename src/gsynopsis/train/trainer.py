"""The state of a training run and its one inner step."""

import resource
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor, nn

from gsynopsis.config import RATES, Config, Joint, RateConfig
from gsynopsis.errors import DivergedError, PeerError
from gsynopsis.model.anchors import AnchorModel, Decoded, LearntMask, LevelPart
from gsynopsis.model.levels import unite_networks
from gsynopsis.render.base import Renderer, Rendering
from gsynopsis.scene.camera import STILL, Shift
from gsynopsis.scene.scene import Scene
from gsynopsis.train.batch import pack_gradients, unpack_gradients
from gsynopsis.train.budget import Packer
from gsynopsis.train.growth import GrowthStatistics
from gsynopsis.train.losses import photometric_loss, volume_loss
from gsynopsis.train.optimiser import Optimiser
from gsynopsis.train.progress import Observer, Silent
from gsynopsis.train.shifts import draw_shift, subpixels_of
from gsynopsis.train.world import World, pairwise_sum

SSIM_WEIGHT = 0.2
"""λ_SSIM of (1 − λ)·L1 + λ·(1 − SSIM) (paper)."""
VOLUME_WEIGHT = 0.001
"""λ_vol on the mean product of scales (paper)."""
SMOOTHING = 0.98
"""Weight of the past in the loss and PSNR that are shown, about 50 steps."""


@dataclass
class Cursor:
    """Where a run stands: everything small that a checkpoint keeps as JSON."""

    phase: int = 0
    begun: bool = False
    """The phase has prepared the model; steps may be done."""
    step: int = 0
    order: list[int] = field(default_factory=list[int])
    """Training views still to come before they are shuffled again."""
    seconds: float = 0.0
    """Training time so far."""
    loss: float = 0.0
    error: float = 0.0
    """Smoothed mean squared error, for the PSNR that is shown."""
    sparsity: float = 0.0
    """λ_s of the controller while masks are learnt."""


@dataclass(frozen=True)
class Outcome:
    """One forward pass: the photometric loss, still attached, and what was drawn."""

    loss: Tensor
    decoded: Decoded
    rendering: Rendering
    error: float


class Trainer:
    """A run in memory: scene, model, optimiser, random states and cursor.

    `model` is None until the first phase has begun or a checkpoint was loaded.
    """

    def __init__(
        self,
        scene: Scene,
        config: Config,
        renderer: Renderer,
        packer: Packer | None = None,
        world: World = World(),  # noqa: B008  (frozen)
    ) -> None:
        """Nothing is trained yet; the same seed gives the same run.

        Args:
            scene: What to train on.
            config: How.
            renderer: Draws.
            packer: Knows the file format; without it sizes cannot be ordered.
            world: This process among those that train together; its size divides `train.batch`.
        """
        self.packer, self.world = packer, world
        self.observer: Observer = Silent()
        self.scene, self.config, self.renderer = scene, config, renderer
        self.rates = RATES[config.train.rates]
        self.cursor = Cursor()
        self.rng = np.random.default_rng(config.train.seed)
        self.generator = torch.Generator().manual_seed(config.train.seed)
        self.background = torch.zeros(3, device=renderer.device)
        self.model: AnchorModel | None = None
        self.optimiser: Optimiser | None = None
        self.statistics: list[GrowthStatistics] = []
        """One per view of a batch that this process works on, while growing; else none."""
        self.mask_logits: nn.Parameter | None = None
        self.subpixels = subpixels_of(scene, config)
        self.shift = STILL
        """Of this step's photos and views."""
        self._shown: list[tuple[float, float]] = []
        self._failure: DivergedError | None = None

    def adopt(self, model: AnchorModel) -> None:
        """Go on with a model, on the renderer's device; common networks become the same again."""
        self.model = model.to(self.renderer.device)
        if self.config.levels.tied:
            unite_networks(model)

    def next_view(self) -> int:
        """A training view, without replacement until all were seen (methods.md §1.7)."""
        if not self.cursor.order:
            shuffled = self.rng.permutation(len(self.scene.train))
            self.cursor.order = [self.scene.train[i] for i in shuffled]
        return self.cursor.order.pop()

    def next_views(self) -> list[int]:
        """The views of a step, `train.batch` of them; draws their shift. Alike in every process."""
        if self.subpixels > 1:
            self.shift = draw_shift(self.rng, self.subpixels)
        return [self.next_view() for _ in range(self.config.train.batch)]

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
        assert self.optimiser is not None
        parameters, own, buffers = self.optimiser.parameters(), self.world.share(views), []
        for place, view in enumerate(own):
            self._shown = []
            yield view
            shown = torch.zeros(len(views), len(self._shown), 2)
            shown[self.world.rank * len(own) + place] = torch.tensor(self._shown)
            buffers.append(pack_gradients(parameters, shown))
        total = self.world.sum(pairwise_sum(buffers))
        shown = unpack_gradients(total, parameters, len(views))
        if self._failure is not None:
            raise self._failure
        if not bool(torch.isfinite(shown).all()):
            raise PeerError("another process of this training diverged; see its message")
        for value, error in shown.tolist():
            self._smooth(value, error)

    def sum_over(
        self, what: str, views: Sequence[int], size: int, of_view: Callable[[int], Tensor]
    ) -> Tensor:
        """The sum of a float32 [size] tensor over views of all processes; `what` is for people.

        Summed as gradients are, each place of the batch its own views and then the places: so it is
        the same, bit for bit, for one process and for two.
        """
        batch, totals = self.config.train.batch, list[Tensor]()
        shares = [views[place::batch] for place in self.world.share(range(batch))]
        done, count = 0, sum(map(len, shares))
        for share in shares:
            total = torch.zeros(size, device=self.renderer.device)
            for view in share:
                total += of_view(view)
                done += 1
                self.observer.on_pass(what, done, count)
            totals.append(total)
        return self.world.sum(pairwise_sum(totals))

    def target(self, view: int, factor: float, shift: Shift = STILL) -> Tensor:
        """A photo as float32 [H, W, 3] in [0, 1]."""
        pixels = torch.from_numpy(self.scene.image(view, factor, shift).copy())
        return pixels.to(self.renderer.device).float() / 255

    def forward(
        self, part: LevelPart, view: int, factor: float, learnt: LearntMask | None = None
    ) -> Outcome:
        """Decode, draw and compare one view at one level."""
        assert self.model is not None
        camera = self.scene.camera(view, factor, self.shift)
        decoded = self.model.decode_part(part, camera, learnt)
        rendering = self.renderer.render(decoded.gaussians, camera, self.background)
        target = self.target(view, factor, self.shift)
        settings = self.config.train
        loss = photometric_loss(rendering.image, target, SSIM_WEIGHT)
        loss = loss + VOLUME_WEIGHT * volume_loss(decoded.gaussians.scales)
        if settings.opacity_weight and self._grown and len(decoded.gaussians.opacities):
            loss = loss + settings.opacity_weight * decoded.gaussians.opacities.mean()
        with torch.no_grad():
            error = float((rendering.image - target).square().mean())
        return Outcome(loss, decoded, rendering, error)

    @property
    def _grown(self) -> bool:
        """Anchors are neither added nor removed any more."""
        settings = self.config.train
        return self.cursor.phase > 0 or self.cursor.step >= settings.growth.until * settings.steps

    def learn(self, loss: Tensor, outcome: Outcome, view: int) -> None:
        """Backward pass and the shown averages; the optimiser step is the phase's business.

        Raises:
            DivergedError: the loss or an opacity is not finite; nothing was changed.
        """
        value = float(loss.detach())
        # A slot whose opacity is NaN is not drawn, so the loss alone would not tell.
        if not np.isfinite(value + float(outcome.decoded.opacity.detach().sum())):
            name = self.scene.views[view].name
            error = DivergedError(
                f"step {self.cursor.step + 1}: view {name} gives a loss of {value} and opacities "
                f"that are not all finite; first non-finite tensor: {self.non_finite() or 'none'}; "
                "the last checkpoint is kept"
            )
            if self.config.train.batch == 1:
                raise error
            # The other processes wait for this step's sum: it tells them.
            self._failure, value = self._failure or error, float("nan")
        if loss.requires_grad:  # nothing adapts while ablation `base` warms up
            loss.backward()
        if self.config.train.batch == 1:
            self._smooth(value, outcome.error)
        else:
            self._shown.append((value, outcome.error))

    def learn_levels(self, levels: Iterable[int], view: int) -> None:
        """Forward and backward of one view at several levels; their weighted gradients add up.

        Raises:
            DivergedError: see `learn`.
        """
        assert self.model is not None
        for level in levels:
            outcome = self.forward(self.model.part(int(level)), view, self.config.scale)
            self.learn(outcome.loss * self._weight(int(level)), outcome, view)

    def _weight(self, level: int) -> float:
        """Factor on a level's loss; the finest has none."""
        assert self.model is not None
        levels = self.config.levels
        loss_weights = levels.loss_weights if isinstance(levels, Joint) else ()
        weights = loss_weights[: len(self.model.parts) - 1]
        return weights[level] if level < len(weights) else 1.0

    def _smooth(self, value: float, error: float) -> None:
        keep = 0.0 if self.cursor.loss == 0 else SMOOTHING
        self.cursor.loss = keep * self.cursor.loss + (1 - keep) * value
        self.cursor.error = keep * self.cursor.error + (1 - keep) * error

    @property
    def psnr(self) -> float:
        """Smoothed training PSNR, dB."""
        return float(-10 * np.log10(max(self.cursor.error, 1e-10)))

    def non_finite(self) -> str | None:
        """Name of the first parameter with a value that is not finite; None if all are."""
        assert self.model is not None
        for name, parameter in self.model.named_parameters():
            if not bool(torch.isfinite(parameter).all()):
                return name
        return None


def shared_parameters(model: AnchorModel) -> dict[str, nn.Parameter]:
    """What all levels share and training moves, by name; empty tensors are left out."""
    names = ("offsets", "log_scales", "logits", "residual", "table")
    found = {name: getattr(model, name) for name in names}
    return {name: p for name, p in found.items() if p.numel()}


def part_parameters(part: LevelPart, prefix: str, gain: bool) -> dict[str, nn.Parameter]:
    """What one level owns, by name; the prefix tells levels apart."""
    found = {f"{prefix}{name}": p for name, p in part.networks.items()}
    if part.codebook.numel():
        found[f"{prefix}codebook"] = part.codebook
    if gain:
        found[f"{prefix}log_gain"] = part.log_gain
    return found


def level_parameters(model: AnchorModel, gain: bool) -> dict[str, nn.Parameter]:
    """What all levels own, by name; each name begins with the number of the first to have it."""
    found: dict[str, nn.Parameter] = {}
    for number in range(len(model.parts)):
        own = part_parameters(model.part(number), f"{number}.", gain)
        known = {id(parameter) for parameter in found.values()}
        found |= {name: p for name, p in own.items() if id(p) not in known}
    return found


def rates_of(
    names: Mapping[str, nn.Parameter], rates: RateConfig, extent: float, free: bool
) -> dict[str, tuple[float, float]]:
    """The learning rates of parameters by their names (methods.md §1.8)."""
    kinds = {
        "offsets": (rates.offset[0] * extent, rates.offset[1] * extent),
        "log_scales": rates.scale,
        "logits": rates.logits,
        "residual": rates.free if free else rates.residual,
        "table": rates.grid,
        "codebook": rates.codebook,
        "log_gain": rates.gain,
        "mask_logits": rates.mask,
        "fuse": rates.fuse,
        "opacity": rates.opacity,
        "cov": rates.cov,
        "color": rates.color,
    }
    found = {}
    for name in names:
        kind = name.rsplit(".", 1)[-1]
        found[name] = kinds[kind] if kind in kinds else kinds[kind.split("_")[0]]
    return found


def peak_memory(device: torch.device) -> int:
    """Peak resident memory of this process, or of the GPU, bytes."""
    if device.type == "cuda":
        return torch.cuda.max_memory_allocated(device)
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
