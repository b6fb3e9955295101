"""3D Gaussian Splatting: plain Gaussians from sparse points, with growth (methods.md §6.1).

Written from the published description. Letters: G Gaussians. Rows before `Training.frozen` stay as
they are, so that later stages can build upon earlier ones; `Training.drawn` tells how many rows the
images of a step show, so that prefixes can be trained.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor, nn
from torch.nn import functional

from gsynopsis._native.runtime import one_torch_thread, release_freed
from gsynopsis.errors import DivergedError
from gsynopsis.model.plain import PlainModel
from gsynopsis.records import SH_0, PlainGaussians
from gsynopsis.render.base import Gaussians, Renderer
from gsynopsis.scene.camera import STILL, Shift
from gsynopsis.scene.scene import Scene
from gsynopsis.training.losses import SSIM_WEIGHT
from gsynopsis.training.optim.adam import MOMENTS, Optimizer
from gsynopsis.training.regularize.jitter import shift_places
from gsynopsis.training.step import draw_jitter
from gsynopsis.training.view_step import photometric_loss

RATES = {
    "means": (1.6e-4, 1.6e-6),
    "log_scales": (5e-3, 5e-3),
    "quaternions": (1e-3, 1e-3),
    "logits": (0.05, 0.05),
    "base": (2.5e-3, 2.5e-3),
    "rest": (1.25e-4, 1.25e-4),
}
"""Learning rates at the first and last step, those of the means in units of the extent (3DGS)."""
PUBLISHED_STEPS = 30_000
"""Training steps of published 3DGS; the shares below refer to its schedule."""
RAISE, GROW_FROM, GROW_UNTIL, RESET = 1 / 30, 1 / 60, 1 / 2, 1 / 10
"""Shares of the steps: between two degrees of the harmonics, where growth begins and ends, between
two resets of opacity."""
RESET_UNTIL = GROW_FROM + (GROW_UNTIL - GROW_FROM) / 3
"""Share of the steps after which opacities are not reset: a third of growth. In a short training
later ones come before every photo was seen again (ours)."""
AVERAGED = 0.15
"""Share of the steps over whose values the result is the mean, as ours has it (§2.5)."""
EVERY = 100
"""Steps between two adjustments."""
THRESHOLD = 2e-4
"""Mean gradient of the projected centre from which a Gaussian is grown, NDC units."""
SMALL, LARGE = 0.01, 0.1
"""Shares of the extent: up to the first Gaussians are cloned and beyond it split; beyond the
second they are pruned once opacities were reset."""
SHRINK = 1.6
"""By which the halves of a split Gaussian are smaller."""
FAINT, RESET_TO = 0.005, 0.01
"""Opacity below which Gaussians are pruned, and that resets leave at most."""
FIRST_OPACITY = 0.1
DEGREE = 3


@dataclass(frozen=True)
class Training:
    """Settings of one training of Gaussians.

    Attributes:
        steps: One view each.
        scale: Photos are divided by this.
        seed: Of views, splits and prefixes.
        grow: True if Gaussians are cloned, split and pruned.
        reset: True if opacities are reset during growth.
        frozen: Rows before this one are rendered and stay as they are.
        drawn: Number of rows that each image of a step shows, given a random generator and the
            number of rows; None: one image of all.
        rates: Factor on `RATES`: trainings shorter than 3DGS's need larger ones.
        most: Growth ends at this number of Gaussians, frozen ones not counted: the threshold alone
            lets each Gaussian of a pixel grow where photos are small, as the gradient in normalised
            device coordinates is the larger then.
        opacities: True if opacities of frozen rows learn, and nothing else of theirs.
        ssim_weight: λ_SSIM of the loss.
        subpixels: Photos are sampled at so many places of a pixel along each axis (§2.7).
    """

    steps: int
    scale: float
    seed: int = 0
    grow: bool = False
    reset: bool = True
    frozen: int = 0
    drawn: Callable[[np.random.Generator, int], tuple[int, ...]] | None = None
    rates: float = 1.0
    most: int = 1_000_000
    opacities: bool = False
    ssim_weight: float = SSIM_WEIGHT
    subpixels: int = 1


def from_points(scene: Scene, degree: int = DEGREE) -> PlainGaussians:
    """Gaussians at the scene's points and backdrop, round, as large as their neighbours are far.

    The backdrop (methods.md §2.16) is grey: what begins with points alone has nothing there.
    """
    points = np.concatenate([scene.points, scene.backdrop])
    colors = np.concatenate([scene.colors, np.full_like(scene.backdrop, 127.5)])
    count = len(points)
    near = min(3, count - 1)
    square = np.full(count, (SMALL * scene.extent) ** 2)
    if near:
        distances, _ = KDTree(points).query(points, k=near + 1)
        square = np.square(distances[:, 1:]).mean(axis=1)
    logs = np.log(np.sqrt(np.maximum(square, 1e-14 * scene.extent**2)))
    sh = np.zeros((count, (degree + 1) ** 2, 3), np.float32)
    sh[:, 0] = (colors / 255 - 0.5) / SH_0
    return PlainGaussians(
        means=points.astype(np.float32),
        log_scales=np.repeat(logs[:, None], 3, axis=1).astype(np.float32),
        quaternions=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        logits=np.full(count, np.log(FIRST_OPACITY / (1 - FIRST_OPACITY)), np.float32),
        sh=sh,
    )


@one_torch_thread()
def train_gaussians(
    start: PlainGaussians,
    scene: Scene,
    renderer: Renderer,
    training: Training,
    tick: Callable[[int, int], None] | None = None,
) -> PlainGaussians:
    """Train Gaussians on a scene's training views.

    Args:
        start: Not modified. Frozen rows come first, in the result too.
        scene: Photos and cameras.
        renderer: With gradients.
        training: Settings.
        tick: Called with steps done and steps in all.

    Raises:
        DivergedError: a loss is not finite.
        SceneError: a photo cannot be decoded.
    """
    return Trainer(start, scene, renderer, training).run(tick)


def prefix(gaussians: Gaussians, count: int) -> Gaussians:
    """The first rows of Gaussians."""
    names = ("means", "quats", "scales", "opacities", "colors")
    return replace(gaussians, **{name: getattr(gaussians, name)[:count] for name in names})


def photo(
    scene: Scene, view: int, scale: float, device: torch.device, shift: Shift = STILL
) -> Tensor:
    """A training photo, [H, W, 3] in [0, 1]."""
    return torch.tensor(scene.image(view, scale, shift), dtype=torch.float32, device=device) / 255


class Trainer:
    """One training of Gaussians; a subclass may have other terms of the loss and other growth."""

    def __init__(
        self, start: PlainGaussians, scene: Scene, renderer: Renderer, training: Training
    ) -> None:
        """As `train_gaussians`."""
        self.scene, self.renderer, self.training = scene, renderer, training
        device = renderer.device
        self.model = PlainModel(start, antialiased=False).to(device)
        named = {name: p for name, p in self.model.named_parameters() if p.numel()}
        self.optimizer = Optimizer(named, {name: self._rates(name) for name in named})
        self.chance = np.random.default_rng(training.seed)
        self.luck = torch.Generator().manual_seed(training.seed)
        self._forget()

    def _rates(self, name: str) -> tuple[float, float]:
        factor = self.training.rates * (self.scene.extent if name == "means" else 1)
        first, last = RATES[name]
        return factor * first, factor * last

    def run(self, tick: Callable[[int, int], None] | None) -> PlainGaussians:
        """Train to the end; the values then."""
        training = self.training
        for number, view in enumerate(self._views(), start=1):
            self._step(number, view)
            if training.grow:
                self.grow(number)
            if number % EVERY == 0:
                # Sizes change as it grows: what was freed holds 23 GiB after 2,500 steps of bonsai.
                release_freed()
            late = number - round(training.steps * (1 - AVERAGED))
            if late > 0:
                self.optimizer.average(1 / late)
            if tick:
                tick(number, training.steps)
        with torch.no_grad():
            self.optimizer.take_average()
        return self.model.gaussians()

    def _views(self) -> Iterator[int]:
        """Training views epoch by epoch, each epoch in a random order."""
        left: list[int] = []
        for _ in range(self.training.steps):
            left = left or self.chance.permutation(self.scene.train).tolist()
            yield left.pop()

    def _step(self, number: int, view: int) -> None:
        training, model, device = self.training, self.model, self.model.means.device
        shifts = shift_places(training.subpixels)
        shift = draw_jitter(self.chance, shifts) if len(shifts) > 1 else STILL
        camera = self.scene.camera(view, training.scale, shift)
        gaussians = model.decode(camera)
        count = len(gaussians)
        shown = training.drawn(self.chance, count) if training.drawn else (count,)
        truth = photo(self.scene, view, training.scale, device, shift)
        black, loss = torch.zeros(3, device=device), self.penalty()
        rendering = None
        for rows in shown:
            rendering = self.renderer.render(prefix(gaussians, rows), camera, black)
            loss = loss + photometric_loss(rendering.image, truth, training.ssim_weight)
        if not bool(torch.isfinite(loss)):
            raise DivergedError(f"Gaussians: the loss of step {number} is not finite")
        loss.backward()
        if training.grow and rendering is not None:
            size = torch.tensor([camera.width, camera.height], device=device) / 2
            norm = (rendering.screen_grad() * size).norm(dim=1)
            self.gradient[: len(norm)] += norm * rendering.visible
            self.seen[: len(norm)] += rendering.visible
        self._hold(number)
        self.optimizer.set_progress(number / training.steps)
        self.optimizer.step()

    def penalty(self) -> Tensor:
        """Terms of the loss beside that of the images."""
        return torch.zeros((), device=self.renderer.device)

    def _hold(self, number: int) -> None:
        """No gradient for frozen rows, nor for degrees of the harmonics that come later."""
        training, rest = self.training, self.model.rest
        if training.frozen:
            for name, parameter in self.model.named_parameters():
                if parameter.grad is not None and not (training.opacities and name == "logits"):
                    parameter.grad[: training.frozen] = 0
        degree = int(number / (RAISE * training.steps)) if training.grow else DEGREE
        if rest.grad is not None:
            rest.grad[:, (degree + 1) ** 2 - 1 :] = 0

    def grow(self, number: int) -> None:
        """Adjust the Gaussians after a step, if it is due."""
        steps = self.training.steps
        if number % EVERY or not GROW_FROM * steps < number < GROW_UNTIL * steps:
            return
        self._adjust(number)
        every = max(EVERY, round(RESET * steps / EVERY) * EVERY)
        if self.training.reset and number % every == 0 and number <= RESET_UNTIL * steps:
            self._reset()

    @torch.no_grad()
    def _adjust(self, number: int) -> None:
        """Clone small ones, split large ones, prune faint and too large ones (§6.1)."""
        training, model, extent = self.training, self.model, self.scene.extent
        mean = self.gradient / self.seen.clamp(min=1)
        largest = model.log_scales.exp().amax(dim=1)
        own = torch.arange(len(mean), device=mean.device) >= training.frozen
        wanted = (mean >= THRESHOLD) & own
        room = max(0, training.most - int(own.sum()))
        if int(wanted.sum()) > room:
            best = torch.where(wanted, mean, 0).topk(room).indices
            wanted = torch.zeros_like(wanted).index_fill_(0, best, True)
        clone, split = wanted & (largest <= SMALL * extent), wanted & (largest > SMALL * extent)
        gone = own & (split | (model.logits.sigmoid() < FAINT))
        if number > RESET * training.steps:
            gone |= own & (largest > LARGE * extent)
        values = {name: p.detach() for name, p in model.named_parameters()}
        halves = [self._half({name: v[split] for name, v in values.items()}) for _ in range(2)]
        clones = {name: v[clone] for name, v in values.items()}
        self.edit(
            ~gone, {name: torch.cat([clones[name], *(h[name] for h in halves)]) for name in values}
        )
        self._forget()

    def _half(self, values: dict[str, Tensor]) -> dict[str, Tensor]:
        """Gaussians somewhere within others, smaller."""
        means, logs = values["means"], values["log_scales"]
        noise = torch.randn(means.shape, generator=self.luck).to(means.device) * logs.exp()
        shift = (rotation(values["quaternions"]) @ noise[:, :, None])[:, :, 0]
        return {**values, "means": means + shift, "log_scales": logs - float(np.log(SHRINK))}

    def edit(self, keep: Tensor, added: dict[str, Tensor]) -> None:
        """Keep some rows, and put others behind them, without momentum."""
        for name, old in list(self.model.named_parameters()):
            parameter = nn.Parameter(torch.cat([old.detach()[keep], added[name]]))
            setattr(self.model, name, parameter)
            if old.numel() or parameter.numel():
                self.optimizer.replace(name, parameter, keep, len(added[name]))

    @torch.no_grad()
    def _reset(self) -> None:
        logits, most = self.model.logits, float(np.log(RESET_TO / (1 - RESET_TO)))
        logits[self.training.frozen :].clamp_(max=most)
        for moment in MOMENTS:
            state = self.optimizer.state.get(logits, {})
            if moment in state:
                state[moment][self.training.frozen :] = 0

    def _forget(self) -> None:
        self.gradient = torch.zeros(len(self.model.means), device=self.renderer.device)
        self.seen = torch.zeros_like(self.gradient)


def rotation(quaternions: Tensor) -> Tensor:
    """Rotation matrices [G, 3, 3] of quaternions w x y z of any length above 0 [G, 4]."""
    w, x, y, z = functional.normalize(quaternions, dim=1).unbind(dim=1)
    rows = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return torch.stack(rows, dim=1).view(-1, 3, 3)
