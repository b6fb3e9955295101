"""Sensitivity of the training images to an error of each value (ours).

The squared change of an image by small errors e of the values is |J e|², and rounding errors are
independent, so the diagonal of JᵀJ is all it takes. One backward pass from random signs r in place
of a loss gives Jᵀr, whose square is that diagonal on average (Hutchinson).
"""

import numpy as np
import torch
from torch import Tensor

from gsynopsis.model.anchors import AnchorModel
from gsynopsis.model.build import model_from_levels
from gsynopsis.records import Float32, LevelSet, Sensitivity, coupled_pairs
from gsynopsis.render.base import random_signs
from gsynopsis.training.batch import take_gradients
from gsynopsis.training.state import TrainState

VIEWS = 96
"""Training views that are looked at, at most, for each level."""
COUPLING = "coupling"
"""Name of the products of residual values among what is summed."""
BEST_ERROR = 1e-3
"""Mean squared error of an image below which it counts as this, 30 dB: few views are overfit, and
then say little about others."""
DECIBELS = 10 / np.log(10)
"""Decibels per unit of the natural logarithm of an error."""


def sensitivity_of(state: TrainState, levels: LevelSet) -> Sensitivity:
    """The sensitivity of what a training's levels share.

    Args:
        state: Scene, settings and renderer; its model and random states are not touched.
        levels: What its model holds.
    """
    model = model_from_levels(levels).to(state.setup.renderer.device)
    for parameter in model.parts.parameters():
        parameter.requires_grad_(False)
    most = _of_level(state, model, 0)
    for level in range(1, len(model.parts)):
        own = _of_level(state, model, level)
        most[COUPLING] += own.pop(COUPLING)
        for name, array in own.items():
            torch.maximum(most[name], array, out=most[name])
    sizes = [len(grid) for grid in levels.shared.grids]
    return Sensitivity(
        log_scales=_array(most["log_scales"]),
        offsets=_array(most["offsets"]),
        residual=_array(most["residual"]),
        grids=[_array(grid) for grid in most["table"].split(sizes)] if sizes else [],
        coupling=_array(most[COUPLING]),
    )


def _of_level(state: TrainState, model: AnchorModel, level: int) -> dict[str, Tensor]:
    """Sensitivity of one level by name; levels look at views in between those of others."""
    named = dict(model.named_parameters(recurse=False))
    parameters = list(named.values())
    pairs = tuple(torch.from_numpy(side) for side in coupled_pairs(model.residual.shape[1]))
    shapes = {name: parameter.shape for name, parameter in named.items()}
    shapes[COUPLING] = torch.Size((len(model), len(pairs[0])))
    sizes = [shape.numel() for shape in shapes.values()]
    stride = -(-len(state.setup.scene.train) // VIEWS)
    views = state.setup.scene.train[level * stride // len(model.parts) :: stride]

    def of_view(view: int) -> Tensor:
        _show(state, model, level, view)
        gradients = dict(zip(named, take_gradients(parameters), strict=True))
        products = _products(gradients["residual"].view_as(model.residual), *pairs)
        return torch.cat([*(array.square() for array in gradients.values()), products])

    total = state.sum_over("weighing values", views, sum(sizes), of_view) / len(views)
    pieces = zip(shapes.items(), total.split(sizes), strict=True)
    return {name: piece.view(shape) for (name, shape), piece in pieces}


def _products(gradients: Tensor, first: Tensor, second: Tensor) -> Tensor:
    """Of pairs of columns of [N, R], flat [N·P]; most rows of a view are zeros."""
    products = gradients.new_zeros(len(gradients), len(first))
    seen = gradients.any(dim=1).nonzero()[:, 0]
    some = gradients[seen]
    products[seen] = some[:, first] * some[:, second]
    return products.view(-1)


def _show(state: TrainState, model: AnchorModel, level: int, view: int) -> None:
    """Gradients whose squares are the loss of one image in decibels, on average."""
    camera = state.setup.scene.camera(view, state.setup.config.scale)
    target = state.target(view, state.setup.config.scale)
    gaussians = model.decode(camera, level)
    image = state.setup.renderer.render(gaussians, camera, state.background).image
    error = max(float((image.detach() - target).square().mean()), BEST_ERROR)
    chance = torch.Generator().manual_seed(view)
    signs = random_signs(image, chance)
    if image.requires_grad:
        weights = signs * (DECIBELS / (error * image.numel())) ** 0.5
        # Of a number, not of the image with weights: that would import torch's compiler.
        (image * weights).sum().backward()


def _array(tensor: Tensor) -> Float32:
    return tensor.cpu().numpy()
