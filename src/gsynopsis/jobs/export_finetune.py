"""A short training of plain Gaussians on photos, from a good start: what baking lost comes back."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from gsynopsis._native.runtime import one_torch_thread
from gsynopsis.errors import DivergedError
from gsynopsis.model.plain import PlainModel
from gsynopsis.records import PlainGaussians
from gsynopsis.render.base import Renderer
from gsynopsis.scene.camera import Camera
from gsynopsis.training.losses import SSIM_WEIGHT
from gsynopsis.training.optim.adam import Optimizer
from gsynopsis.training.view_step import photometric_loss

RATES = {
    "means": (8e-5, 8e-6),
    "log_scales": (1.2e-2, 1.2e-3),
    "quaternions": (5e-3, 5e-4),
    "logits": (0.1, 0.01),
    "base": (1.2e-2, 1.2e-3),
    "rest": (1.2e-3, 1.2e-4),
}
"""Learning rates at the first and last step, those of the means in units of the scene's extent:
2.4 to 5 times 3DGS's, which are for thirty times as many steps (ours, chosen on fox)."""


class Shot(NamedTuple):
    """A view to train on.

    Attributes:
        camera: Its camera.
        picture: Its image, [H, W, 3] in [0, 1] on the renderer's device.
        light: Background of both, [3]; None: black.
        level: Of a model of several, which is to look so.
    """

    camera: Camera
    picture: Tensor
    light: Tensor | None = None
    level: int = -1


@dataclass(frozen=True)
class FineTuning:
    """Settings of fine-tuning.

    Attributes:
        steps: One view each.
        extent: Extent of the scene, world units: rates of means are in its units.
        seed: Seed of the order of views.
        rate_scale: Factor on all of `RATES`.
    """

    steps: int
    extent: float
    seed: int = 0
    rate_scale: float = 1.0


@one_torch_thread()
def fine_tune(
    model: PlainModel,
    views: int,
    shot: Callable[[int], Shot],
    renderer: Renderer,
    tuning: FineTuning,
    tick: Callable[[int, int], None] | None = None,
) -> PlainGaussians:
    """Train all values with Adam, on views in random order, equally often.

    Args:
        model: On the renderer's device; it is trained in place. Neither growth nor pruning.
        views: Number of training views, at least one.
        shot: Camera and image of a view.
        renderer: With gradients.
        tuning: Settings.
        tick: Called with steps done and steps in all.

    Raises:
        DivergedError: a loss is not finite.
    """
    scale = tuning.rate_scale
    rates = {
        name: tuple(scale * rate * (tuning.extent if name == "means" else 1) for rate in pair)
        for name, pair in RATES.items()
    }
    named = {name: parameter for name, parameter in model.named_parameters() if parameter.numel()}
    optimizer = Optimizer(named, {name: (rates[name][0], rates[name][1]) for name in named})
    black = torch.zeros(3, device=renderer.device)
    for done, view in enumerate(_order(views, tuning), start=1):
        camera, picture, light, level = shot(view)
        gaussians = model.decode(camera, level)
        image = renderer.render(gaussians, camera, black if light is None else light).image
        loss = photometric_loss(image, picture, SSIM_WEIGHT)
        if not bool(torch.isfinite(loss)):
            raise DivergedError(f"fine-tuning: the loss of step {done} is not finite")
        loss.backward()
        optimizer.set_progress(done / tuning.steps)
        optimizer.step()
        if tick:
            tick(done, tuning.steps)
    return model.gaussians()


def _order(views: int, tuning: FineTuning) -> Iterator[int]:
    """Views epoch by epoch, each epoch in a random order."""
    chance = np.random.default_rng(tuning.seed)
    left: list[int] = []
    for _ in range(tuning.steps):
        left = left or chance.permutation(views).tolist()
        yield left.pop()
