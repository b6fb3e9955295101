"""One view of a training step: load, decode, drop out, render, compare, loss, backward, count.

Every phase trains by `train_view`. Native kernels do the work on the CPU and PyTorch elsewhere; the
road is chosen once, when the training gets its model (`passes.py`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from gsynopsis._native import _core
from gsynopsis._native.runtime import empty_buffer, empty_buffer_like, thread_count
from gsynopsis.model.anchors import LearntMask, LevelPart
from gsynopsis.model.tables import Decoded
from gsynopsis.records import Float32
from gsynopsis.render.base import Rendering, sent
from gsynopsis.scene.camera import STILL, Shift
from gsynopsis.training.device_photos import Mask
from gsynopsis.training.growth import GrowthStatistics
from gsynopsis.training.losses import (
    SSIM_WEIGHT,
    mean_squared_reference,
    photometric_reference,
    unit_pixels_reference,
    volume_reference,
)
from gsynopsis.training.passes import AutogradPass, ViewPass
from gsynopsis.training.regularize.exposure import WARM_UP, unsaturated
from gsynopsis.training.state import TrainState
from gsynopsis.training.step import log_step, log_view
from gsynopsis.training.whole_step import Sums, ViewJob

VOLUME_WEIGHT = 0.001
"""λ_vol on the mean product of scales (paper)."""
LEAST_SHARE = 0.01
"""Least share of a photo by which a masked loss is divided: smaller masks do not count more."""
Penalty = Callable[[Decoded], Tensor]
"""A further loss [] of what a view decodes."""
Measure = Callable[[Float32, Float32 | None], float]
"""Finds a number from values, and its gradient where there is room for it."""


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
    if state.whole is not None:
        assert mask is None and penalty is None  # `whole_step` saw to it
        job = view_job(state, part, view, factor, weight, counters)
        log_step(state, (view,), state.whole.train_view(job)[None])
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
        count_view(counters, result.decoded, result.rendering)


def forward_view(
    state: TrainState, part: LevelPart, view: int, factor: float, mask: LearntMask | None = None
) -> tuple[ViewResult, ViewPass]:
    """Decode, render and compare one view; the pass takes the gradients of a loss of it."""
    context = state.context
    camera = context.scene.camera(view, factor, state.jitter)
    make_pass = state.make_pass if mask is None else partial(AutogradPass, mask=mask)
    photo = load_target(state, view, factor, state.jitter)

    passed = make_pass(state.model, context.renderer, part, camera)
    gaussians = passed.decoded.gaussians
    rendering = passed.render(
        draw_dropout(state, view, gaussians.opacities), background_of(state, view)
    )

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


def unit_pixels(pixels: Tensor | NDArray[np.uint8]) -> Tensor:
    """A photo, uint8 [H, W, 3], as float32 in [0, 1].

    Native on the CPU, plain PyTorch elsewhere.
    """
    if isinstance(pixels, Tensor):
        if pixels.device.type != "cpu":
            return unit_pixels_reference(pixels)
        pixels = pixels.numpy()
    values = empty_buffer(*pixels.shape)
    flat = np.ascontiguousarray(pixels).reshape(-1)
    _core.in_unit(flat, values.view(-1).numpy(), thread_count())
    return values


def background_of(state: TrainState, view: int) -> Tensor:
    """Color behind everything in a view, [3]: white in every other one if photos have an alpha."""
    return (
        state.background + 1 if state.context.alpha is not None and view % 2 else state.background
    )


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


def dropout_factors(opacities: Tensor, share: float, key: tuple[int, ...]) -> Tensor:
    """Factors on opacities of an image's Gaussians, float32 [G]: 0 leaves a Gaussian out.

    After H. Park, G. Ryu and W. Kim, "DropGaussian", CVPR 2025 (methods.md §2.17): the Gaussians
    that replace the dropped ones must fit all photos, where each would be fit by its own.

    The others are opaquer by 1 / (1 - share), up to an opacity of 1, so that the image is about as
    opaque. For gradients of the opacities the factors are constants.

    Args:
        opacities: Of the Gaussians, [G] in [0, 1].
        share: How many are left out on average, in [0, 1).
        key: Of the step and view, each ≥ 0; the same one gives the same factors.
    """
    with torch.no_grad():
        kept = sent(torch.from_numpy(drawn_lots(len(opacities), share, key)), opacities.device)
        return kept * (opacities.clamp(min=1e-12).reciprocal()).clamp(max=1 / (1 - share))


def drawn_lots(count: int, share: float, key: tuple[int, ...]) -> NDArray[np.bool_]:
    """False for what is left out, bool [count]; see `dropout_factors`."""
    return np.random.default_rng(key).random(count, np.float32) >= share


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


def photometric_loss(image: Tensor, target: Tensor, ssim_weight: float) -> Tensor:
    """(1 − λ)·L1 + λ·(1 − SSIM) over images [H, W, 3] in [0, 1]; differentiable in `image` only.

    Native on the CPU in float32, plain PyTorch elsewhere.
    """
    if image.device.type == "cpu" and image.dtype == torch.float32:
        truth = target.contiguous().numpy()

        def measure(values: Float32, grad: Float32 | None) -> float:
            return _core.photometric(values, truth, ssim_weight, grad, thread_count())

        return _Measured.apply(image, measure)  # type: ignore[no-any-return]
    return photometric_reference(image, target, ssim_weight)


def volume_loss(scales: Tensor) -> Tensor:
    """Mean product of the three scales of the rendered Gaussians [G, 3], world units³; 0 if none.

    Native on the CPU in float32, plain PyTorch elsewhere.
    """
    if scales.device.type == "cpu" and scales.dtype == torch.float32 and len(scales):
        return _Measured.apply(scales, _core.mean_volume)  # type: ignore[no-any-return]
    return volume_reference(scales)


def mean_squared_error(image: Tensor, target: Tensor) -> Tensor:
    """Mean squared error of two images [H, W, 3], float64, without a gradient.

    Native on the CPU in float32, plain PyTorch elsewhere.
    """
    one, other = image.detach(), target.detach()
    if one.device.type == "cpu" and one.dtype == torch.float32:
        first, second = (t.contiguous().view(-1).numpy() for t in (one, other))
        return torch.tensor(_core.mean_squared(first, second, thread_count()), dtype=torch.float64)
    return mean_squared_reference(image, target)


class _Measured(torch.autograd.Function):
    """A number and its gradient, which one native pass finds together."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, measure: Measure) -> Tensor:
        grad = empty_buffer_like(values) if ctx.needs_input_grad[0] else None
        array = values.detach().contiguous().numpy()
        ctx.grad = grad
        return torch.tensor(measure(array, None if grad is None else grad.numpy()))

    @staticmethod
    @once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx: Any, *grads: Tensor
    ) -> tuple[Tensor, None]:
        # Given away, so that a leaf takes it as it is: an image more is felt in a step.
        grad, ctx.grad = ctx.grad, None
        if grad is None:
            raise RuntimeError("its gradient was given to an earlier backward pass")
        return (grad if grads[0] == 1 else grad.mul_(grads[0])), None


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


def count_view(counters: GrowthStatistics, decoded: Decoded, rendering: Rendering) -> None:
    """Count a view in the growth statistics, after its backward pass: natively on the CPU.

    Args:
        counters: They are added to.
        decoded: Gaussians that were rendered.
        rendering: Its image [H, W, 3], visibility [G] and gradients on screen [G, 2], 1/pixels.
    """
    grad, visible = rendering.screen_grad(), rendering.visible
    height, width, _ = rendering.image.shape
    if counters.gradient.device.type != "cpu":
        counters.count(decoded, grad, visible, (width, height))
        return
    shown, opacity = visible.view(torch.uint8), decoded.opacity.detach().contiguous()
    seen = (decoded.slots, decoded.anchors, grad.contiguous(), shown, opacity)
    totals = (counters.gradient, counters.drawn, counters.opacity, counters.visits)
    _core.count_view(seen, (width, height), totals, thread_count())


def view_job(
    state: TrainState,
    part: LevelPart,
    view: int,
    factor: float,
    weight: float,
    counters: GrowthStatistics | None,
) -> ViewJob:
    """A view for a device that trains it wholly; see `train_view`."""
    scene, jitter, alpha = state.context.scene, state.jitter, state.context.alpha
    red, green, blue = background_of(state, view).tolist()
    dropout, camera = state.context.config.train.dropout, scene.camera(view, factor, jitter)

    def behind() -> NDArray[np.uint8]:
        assert alpha is not None and red == green == blue  # the background is black or white
        return (255 * red * (1 - alpha(view, factor, jitter))).round().byte().numpy()

    def mask() -> tuple[NDArray[np.float32], float]:
        weights = scene.mask(view, factor, jitter)
        assert weights is not None
        return weights, max(float(weights.mean()), LEAST_SHARE)

    def gains(sums: Sums) -> tuple[float, float, float]:
        assert state.exposures is not None
        if _solves_exposures(state):
            state.exposures.move(view, sums(), camera.width * camera.height)
        return state.exposures.gains(view)

    def lots(count: int) -> NDArray[np.bool_]:
        return drawn_lots(count, dropout, dropout_key(state, view))

    return ViewJob(
        model=state.model,
        part=part,
        camera=camera,
        photo=(view, factor, jitter),
        pixels=lambda: scene.image(view, factor, jitter),
        behind=None if alpha is None else behind,
        mask=mask if counts_masks(state) and scene.views[view].mask is not None else None,
        gains=None if state.exposures is None else gains,
        background=(red, green, blue),
        weight=weight,
        volume=volume_weight(state),
        opacity=state.context.config.train.opacity_weight if has_grown(state) else 0.0,
        dropout=(dropout, lots) if dropout else None,
        counters=None if counters is None else counters.tensors(),
    )
