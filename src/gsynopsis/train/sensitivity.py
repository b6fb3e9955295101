"""How much an error of each value costs the pictures, from pictures of the training views (ours).

The squared change of a picture by small errors e of the values is |J e|², and rounding errors are
independent, so the diagonal of JᵀJ is all it takes. One backward pass from random signs r in place
of a loss gives Jᵀr, whose square is that diagonal on average (Hutchinson).
"""

import numpy as np
import torch
from torch import Tensor

from gsynopsis.model.anchors import AnchorModel
from gsynopsis.model.build import model_from_levels
from gsynopsis.records import Float32, LevelSet, Sensitivity
from gsynopsis.render.base import random_signs
from gsynopsis.train.batch import take_gradients
from gsynopsis.train.trainer import Trainer

VIEWS = 48
"""Training views that are looked at, at most."""
BEST_ERROR = 1e-3
"""Mean squared error of a picture below which it counts as this, 30 dB: few views are learnt by
heart, and what they show then says little about others."""
DECIBELS = 10 / np.log(10)
"""What the logarithm of an error is in decibels."""


def sensitivity_of(trainer: Trainer, levels: LevelSet) -> Sensitivity:
    """The sensitivity of what a trainer's levels share.

    Args:
        trainer: Scene, settings and renderer; its model and random states are not touched.
        levels: What its model holds.
    """
    model = model_from_levels(levels).to(trainer.renderer.device)
    for parameter in model.parts.parameters():
        parameter.requires_grad_(False)
    most = _of_level(trainer, model, 0)
    for level in range(1, len(model.parts)):
        for name, own in _of_level(trainer, model, level).items():
            torch.maximum(most[name], own, out=most[name])
    sizes = [len(grid) for grid in levels.shared.grids]
    return Sensitivity(
        log_scales=_array(most["log_scales"]),
        offsets=_array(most["offsets"]),
        residual=_array(most["residual"]),
        grids=[_array(grid) for grid in most["table"].split(sizes)] if sizes else [],
    )


def _of_level(trainer: Trainer, model: AnchorModel, level: int) -> dict[str, Tensor]:
    """By name, of what one level shows."""
    named = dict(model.named_parameters(recurse=False))
    parameters = list(named.values())
    sizes = [parameter.numel() for parameter in parameters]
    views = trainer.scene.train[:: -(-len(trainer.scene.train) // VIEWS)]

    def of_view(view: int) -> Tensor:
        _show(trainer, model, level, view)
        return torch.cat(take_gradients(parameters)).square()

    pieces = (trainer.sum_over("weighing values", views, sum(sizes), of_view) / len(views)).split(
        sizes
    )
    return {n: t.view_as(p) for (n, p), t in zip(named.items(), pieces, strict=True)}


def _show(trainer: Trainer, model: AnchorModel, level: int, view: int) -> None:
    """Gradients whose squares are the loss of one picture in decibels, on average."""
    camera = trainer.scene.camera(view, trainer.config.scale)
    target = trainer.target(view, trainer.config.scale)
    gaussians = model.decode(camera, level)
    image = trainer.renderer.render(gaussians, camera, trainer.background).image
    error = max(float((image.detach() - target).square().mean()), BEST_ERROR)
    chance = torch.Generator().manual_seed(view)
    signs = random_signs(image, chance)
    if image.requires_grad:
        image.backward(signs * (DECIBELS / (error * image.numel())) ** 0.5)


def _array(tensor: Tensor) -> Float32:
    return tensor.cpu().numpy()
