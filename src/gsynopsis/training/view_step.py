"""One view of a training step, from the photo to the gradients; every phase trains by it.

for view in synced_views(state, next_views(state)):
    train_view(state, state.model.part(-1), view, scale)
state.optimizer.set_progress(progress)
optimizer_step(state)
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gsynopsis.model.anchors import LearntMask, LevelPart
from gsynopsis.model.tables import Decoded
from gsynopsis.render.base import Rendering
from gsynopsis.scene.camera import STILL, Shift
from gsynopsis.training.device_photos import Mask
from gsynopsis.training.growth import GrowthStatistics
from gsynopsis.training.loss_log import log_step, log_view
from gsynopsis.training.losses import (
    SSIM_WEIGHT,
    mean_squared_error,
    photometric_loss,
    unit_pixels,
    volume_loss,
)
from gsynopsis.training.passes import AutogradPass, Sums, ViewJob, ViewPass
from gsynopsis.training.regularize.dropout import dropout_factors
from gsynopsis.training.regularize.exposure import WARM_UP, unsaturated
from gsynopsis.training.state import TrainState, background_of

VOLUME_WEIGHT = 0.001
"""λ_vol on the mean product of scales (paper)."""
LEAST_SHARE = 0.01
"""Least share of a photo by which a masked loss is divided: smaller masks do not count more."""
Penalty = Callable[[Decoded], Tensor]
"""A further loss [] of what a view decodes."""


@dataclass(frozen=True)
class ViewResult:
    """One view that was rendered and compared.

    Attributes:
        loss: Photometric and volume loss, still attached, [].
        decoded: Gaussians and the anchors they come from.
        rendering: Image, alpha, visibility and gradients on screen.
        error: Mean squared error over the pixels that count, float64 [].
    """

    loss: Tensor
    decoded: Decoded
    rendering: Rendering
    error: Tensor


def train_view(  # noqa: PLR0913 -- three of them are for one phase each
    state: TrainState,
    part: LevelPart,
    view: int,
    factor: float,
    weight: float = 1.0,
    *,
    mask: LearntMask | None = None,
    penalty: Penalty | None = None,
    counters: GrowthStatistics | None = None,
) -> None:
    """Forward and backward pass of one view at one level; gradients add up in the parameters.

    Args:
        state: Its gradients and losses change, nothing else.
        part: Level to decode.
        view: Index into the scene's views.
        factor: Reduction of the photo's width and height, ≥ 1.
        weight: Factor on the loss.
        mask: Slots' mask, where it is learnt.
        penalty: A further loss.
        counters: Growth statistics that count the view; None: it is not counted.

    Raises:
        DivergedError: the loss or an opacity is not finite; no gradient was added, unless losses
            are read later, see `LossLog.read_every`.
    """
    whole = state.passes.whole
    if whole is not None:
        assert mask is None and penalty is None  # `whole_step` saw to it
        job = view_job(state, part, view, factor, weight, counters)
        log_step(state, (view,), whole.train_view(job)[None])
        return
    result, passed = forward_view(state, part, view, factor, mask)
    loss = result.loss * weight
    if penalty is not None:
        loss = loss + penalty(result.decoded)
    # A slot whose opacity is NaN is not rendered, so the loss alone would not show it.
    value = loss.detach() + 0 * result.decoded.opacity.detach().sum()
    log_view(state, view, value.double(), result.error)
    passed.backward(loss)
    if counters is not None:
        rendering, (height, width, _) = result.rendering, result.rendering.image.shape
        size = width, height
        counters.observe(result.decoded, rendering.screen_grad(), rendering.visible, size)


def view_job(
    state: TrainState,
    part: LevelPart,
    view: int,
    factor: float,
    weight: float,
    counters: GrowthStatistics | None,
) -> ViewJob:
    """A view for a device that trains it wholly; see `train_view`."""
    scene, jitter = state.context.scene, state.jitter
    red, green, blue = background_of(state, view).tolist()
    dropout, camera = state.context.config.train.dropout, scene.camera(view, factor, jitter)

    def mask() -> tuple[NDArray[np.float32], float]:
        weights = scene.mask(view, factor, jitter)
        assert weights is not None
        return weights, max(float(weights.mean()), LEAST_SHARE)

    def gains(sums: Sums) -> tuple[float, float, float]:
        assert state.exposures is not None
        if _solves_exposures(state):
            state.exposures.move(view, sums(), camera.width * camera.height)
        return state.exposures.gains(view)

    return ViewJob(
        model=state.model,
        part=part,
        camera=camera,
        photo=(view, factor, jitter),
        pixels=lambda: scene.image(view, factor, jitter),
        mask=mask if counts_masks(state) and scene.views[view].mask is not None else None,
        gains=None if state.exposures is None else gains,
        background=(red, green, blue),
        weight=weight,
        volume=volume_weight(state),
        opacity=state.context.config.train.opacity_weight if has_grown(state) else 0.0,
        dropout=(dropout, dropout_key(state, view)) if dropout else None,
        counters=None if counters is None else counters.tensors(),
    )


def forward_view(
    state: TrainState, part: LevelPart, view: int, factor: float, mask: LearntMask | None = None
) -> tuple[ViewResult, ViewPass]:
    """Decode, render and compare one view; the pass takes the gradients of a loss of it."""
    context = state.context
    camera = context.scene.camera(view, factor, state.jitter)
    passes = state.passes if mask is None else partial(AutogradPass, mask=mask)

    passed = passes(state.model, context.renderer, part, camera)
    gaussians = passed.decoded.gaussians
    rendering = passed.render(
        draw_dropout(state, view, gaussians.opacities), background_of(state, view)
    )

    photo = load_target(state, view, factor, state.jitter)
    image, share = compare(state, rendering.image, photo, view, factor)
    loss = photometric_loss(image, photo, SSIM_WEIGHT) / share
    loss = loss + volume_weight(state) * volume_loss(gaussians.scales)
    opacity_weight = context.config.train.opacity_weight
    # Opacities are pushed down only once growth has ended, which judges anchors by them.
    if opacity_weight and has_grown(state) and len(gaussians.opacities):
        loss = loss + opacity_weight * gaussians.opacities.mean()
    error = mean_squared_error(image, photo) / share
    return ViewResult(loss, passed.decoded, rendering, error), passed


def load_target(state: TrainState, view: int, factor: float, jitter: Shift = STILL) -> Tensor:
    """A photo over its view's background, float32 [H, W, 3] in [0, 1], on the training's device.

    Raises:
        SceneError: the pixel data cannot be decoded.
    """
    if state.photos is not None:
        photo = unit_pixels(state.photos.get(view, factor, jitter))
    else:
        photo = unit_pixels(state.context.scene.image(view, factor, jitter))
    if state.context.alpha is None:
        return photo
    alpha = state.context.alpha(view, factor, jitter).to(photo.device)
    return photo + (1 - alpha)[:, :, None] * background_of(state, view)


def load_mask(state: TrainState, view: int, factor: float) -> Mask | None:
    """Weights of the photo's pixels [H, W] in [0, 1] and their mean; None: all pixels count.

    Raises:
        SceneError: the pixel data cannot be decoded.
    """
    scene = state.context.scene
    if not counts_masks(state):
        return None
    if state.photos is not None:
        return state.photos.mask(view, factor, state.jitter)
    mask = scene.mask(view, factor, state.jitter)
    return None if mask is None else (torch.from_numpy(mask), float(mask.mean()))


def counts_masks(state: TrainState) -> bool:
    """Pixels outside of masks do not count in the loss."""
    return state.context.scene.reading.masks in ("loss", "alpha")


def draw_dropout(state: TrainState, view: int, opacities: Tensor) -> Tensor | None:
    """Factors on the opacities [G] of this step's image of a view; None: no dropout."""
    train = state.context.config.train
    if not train.dropout:
        return None
    return dropout_factors(opacities, train.dropout, dropout_key(state, view))


def dropout_key(state: TrainState, view: int) -> tuple[int, ...]:
    """Seeds of an image of a step, so that a resumed training drops the same Gaussians."""
    progress = state.progress
    return state.context.config.train.seed, progress.phase, progress.step, view


def compare(
    state: TrainState, image: Tensor, photo: Tensor, view: int, factor: float
) -> tuple[Tensor, float]:
    """A rendering in the photo's exposure, with the photo's own pixels where its mask is zero.

    Args:
        state: Gains of the photos move where they are solved.
        image: The rendering, [H, W, 3].
        photo: [H, W, 3] in [0, 1].
        view: Index into the scene's views.
        factor: Reduction of the photo.

    Returns:
        The image to compare, [H, W, 3], and the share of it that counts, in (0, 1].
    """
    mask = load_mask(state, view, factor)
    if state.exposures is not None:
        if _solves_exposures(state):
            state.exposures.solve(image, photo, view, None if mask is None else mask[0])
        image = unsaturated(state.exposures.applied(image, view), photo)
    if mask is None:
        return image, 1.0
    weights, share = mask
    return photo + weights[:, :, None] * (image - photo), max(share, LEAST_SHARE)


def volume_weight(state: TrainState) -> float:
    """λ_vol on volumes in world units, as it is stated for the unit of the learning rates."""
    unit = state.context.rates.unit_extent
    return VOLUME_WEIGHT * ((unit / state.model.frame.extent) ** 3 if unit else 1.0)


def has_grown(state: TrainState) -> bool:
    """Growth has ended: anchors are neither added nor removed any more."""
    train, progress = state.context.config.train, state.progress
    return progress.phase > 0 or progress.step >= train.growth.until * train.steps


def _solves_exposures(state: TrainState) -> bool:
    """Renderings are good enough to tell how bright photos are; a block has the whole's gains."""
    warm = state.progress.step >= WARM_UP * state.context.config.train.steps
    return state.context.region is None and (state.progress.phase > 0 or warm)
