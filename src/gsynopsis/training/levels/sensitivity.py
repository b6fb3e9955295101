"""Sensitivity of the training images to an error of each value (ours).

The squared change of an image by small errors e of the values is |J e|², and rounding errors are
independent, so the diagonal of JᵀJ is all it takes. One backward pass from random signs r in place
of a loss gives Jᵀr, whose square is that diagonal on average (Hutchinson).
"""

import numpy as np
import torch
from torch import Tensor, nn

from gsynopsis.model.anchors import AnchorModel
from gsynopsis.model.build import model_from_levels
from gsynopsis.records import Float32, LevelSet, Sensitivity, coupled_pairs
from gsynopsis.render.measures import random_signs
from gsynopsis.training.distributed.gradient_sync import take_gradients
from gsynopsis.training.distributed.view_sums import sum_over_views
from gsynopsis.training.regularize.exposure import unsaturated
from gsynopsis.training.state import TrainState, bring_home
from gsynopsis.training.view_step import background_of, load_target

VIEWS = 96
"""Most training views that are used for each level."""
VALUES = ("offsets", "log_scales", "residual", "table")
"""Tensors of a model whose sensitivity is asked for."""
COUPLING = "coupling"
"""Name of the products of residual values among the sums."""
BEST_ERROR = 1e-3
"""Mean squared error of an image below which it counts as this, 30 dB: few views are overfit, and
then say little about others."""
DECIBELS = 10 / np.log(10)
"""Decibels per unit of the natural logarithm of an error."""


def sensitivity_of(state: TrainState, levels: LevelSet) -> Sensitivity:
    """The sensitivity of the values that a training's levels share.

    Args:
        state: Scene, settings and renderer; its model and random states are not touched.
        levels: What its model holds.
    """
    model = model_from_levels(levels).to(state.context.renderer.device)
    for parameter in (*model.parts.parameters(), model.logits):
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
    """Sensitivity of one level by name; levels take turns in the views they use."""
    pairs = tuple(torch.from_numpy(side) for side in coupled_pairs(model.residual.shape[1]))
    shapes = {name: getattr(model, name).shape for name in VALUES}
    shapes[COUPLING] = torch.Size((len(model), len(pairs[0])))
    sizes = [shape.numel() for shape in shapes.values()]
    stride = -(-len(state.context.scene.train) // VIEWS)
    views = state.context.scene.train[level * stride // len(model.parts) :: stride]

    def named(total: Tensor) -> dict[str, Tensor]:
        pieces = zip(shapes.items(), total.split(sizes), strict=True)
        return {name: piece.view(shape) for (name, shape), piece in pieces}

    def add(view: int, total: Tensor) -> None:
        sums = named(total)
        rows, gradients = _gradients(state, model, level, view)
        for name, gradient in gradients.items():
            if name == "table":
                sums[name] += gradient.square()
            else:
                sums[name].index_add_(0, rows, gradient[rows].square())
        own = gradients["residual"]
        seen = own.any(dim=1).nonzero()[:, 0]  # most rows of a view are zeros
        first, second = (own[seen][:, side] for side in pairs)
        sums[COUPLING].index_add_(0, seen, first * second)

    return named(sum_over_views(state, "weighing values", views, sum(sizes), add) / len(views))


def _gradients(
    state: TrainState, model: AnchorModel, level: int, view: int
) -> tuple[Tensor, dict[str, Tensor]]:
    """Gradients whose squares are the loss of one image in decibels, on average.

    Returns:
        Rows of the anchors in view, int64 [V], outside of which gradients are zero; and by name the
        gradients of all values.
    """
    camera = state.context.scene.camera(view, state.context.config.scale)
    photo = load_target(state, view, state.context.config.scale)
    bring_home(state)
    passed = state.make_pass(model, state.context.renderer, model.part(level), camera)
    image = passed.render(None, background_of(state, view)).image
    # Of a number, not of the image with weights: that would import torch's compiler.
    passed.backward((image * _weights(state, image, photo, view)).sum())
    named: dict[str, nn.Parameter] = {name: getattr(model, name) for name in VALUES}
    flat = zip(named.items(), take_gradients(list(named.values())), strict=True)
    return passed.decoded.anchors, {name: grad.view_as(leaf) for (name, leaf), grad in flat}


def _weights(state: TrainState, image: Tensor, target: Tensor, view: int) -> Tensor:
    """Random signs of an image, such that the squares of their gradients are decibels."""
    shown = image.detach()
    if state.exposures is not None:  # a photo's exposure is no error of the model
        shown = unsaturated(state.exposures.applied(shown, view), target)
    error = max(float((shown - target).square().mean()), BEST_ERROR)
    signs = random_signs(image, torch.Generator().manual_seed(view))
    return signs * (DECIBELS / (error * image.numel())) ** 0.5


def _array(tensor: Tensor) -> Float32:
    return tensor.cpu().numpy()
