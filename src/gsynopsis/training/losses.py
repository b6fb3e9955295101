"""Photometric loss, its SSIM, and the sparsity terms of unfolding."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn import functional

from gsynopsis._native import _core
from gsynopsis._native.runtime import empty_buffer, empty_buffer_like, thread_count
from gsynopsis.records import Float32

SSIM_WEIGHT = 0.2
"""λ_SSIM of (1 − λ)·L1 + λ·(1 − SSIM) (paper)."""
SSIM_C1 = 0.01**2
SSIM_C2 = 0.03**2
SSIM_RADIUS = 5
SSIM_SIGMA = 1.5
Measure = Callable[[Float32, Float32 | None], float]
"""Finds a number from values, and its gradient where there is room for it."""


def ssim_window(dtype: torch.dtype, device: torch.device) -> Tensor:
    """The 11 weights of the Gaussian window, σ = 1.5, sum 1."""
    x = torch.arange(-SSIM_RADIUS, SSIM_RADIUS + 1, dtype=dtype, device=device)
    weights = torch.exp(-(x**2) / (2 * SSIM_SIGMA**2))
    return weights / weights.sum()


def ssim(image: Tensor, target: Tensor) -> Tensor:
    """Mean SSIM of two images [H, W, 3], zero padded 11×11 Gaussian window (methods.md §1.7)."""
    a, b = image.permute(2, 0, 1)[None], target.permute(2, 0, 1)[None]  # [1, 3, H, W]
    stack = torch.cat([a, b, a * a, b * b, a * b], dim=1)  # [1, 15, H, W]
    window = ssim_window(image.dtype, image.device)
    channels = stack.shape[1]
    row = window.view(1, 1, 1, -1).expand(channels, 1, 1, -1)
    column = window.view(1, 1, -1, 1).expand(channels, 1, -1, 1)
    stack = functional.conv2d(stack, row, padding=(0, SSIM_RADIUS), groups=channels)
    stack = functional.conv2d(stack, column, padding=(SSIM_RADIUS, 0), groups=channels)
    mean_a, mean_b, aa, bb, ab = stack.split(3, dim=1)
    variance = aa - mean_a**2 + bb - mean_b**2
    covariance = ab - mean_a * mean_b
    top = (2 * mean_a * mean_b + SSIM_C1) * (2 * covariance + SSIM_C2)
    bottom = (mean_a**2 + mean_b**2 + SSIM_C1) * (variance + SSIM_C2)
    return (top / bottom).mean()


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


def mean_squared_error(image: Tensor, target: Tensor) -> Tensor:
    """Mean squared error of two images [H, W, 3], float64, without a gradient.

    Native on the CPU in float32, plain PyTorch elsewhere.
    """
    one, other = image.detach(), target.detach()
    if one.device.type == "cpu" and one.dtype == torch.float32:
        first, second = (t.contiguous().view(-1).numpy() for t in (one, other))
        return torch.tensor(_core.mean_squared(first, second, thread_count()), dtype=torch.float64)
    return mean_squared_reference(image, target)


def mean_squared_reference(image: Tensor, target: Tensor) -> Tensor:
    """`mean_squared_error` in plain PyTorch, any dtype and device: the oracle."""
    with torch.no_grad():
        return (image - target).square().mean().double()


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


def unit_pixels_reference(pixels: Tensor | NDArray[np.uint8]) -> Tensor:
    """`unit_pixels` in plain PyTorch, any device: the oracle."""
    pixels = pixels if isinstance(pixels, Tensor) else torch.from_numpy(pixels.copy())
    return pixels.float() / 255


def photometric_reference(image: Tensor, target: Tensor, ssim_weight: float) -> Tensor:
    """`photometric_loss` in plain PyTorch, any dtype and device: the oracle."""
    loss = (1 - ssim_weight) * (image - target).abs().mean()
    if ssim_weight:
        loss = loss + ssim_weight * (1 - ssim(image, target))
    return loss


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


def volume_loss(scales: Tensor) -> Tensor:
    """Mean product of the three scales of the rendered Gaussians [G, 3], world units³; 0 if none.

    Native on the CPU in float32, plain PyTorch elsewhere.
    """
    if scales.device.type == "cpu" and scales.dtype == torch.float32 and len(scales):
        return _Measured.apply(scales, _core.mean_volume)  # type: ignore[no-any-return]
    return volume_reference(scales)


def volume_reference(scales: Tensor) -> Tensor:
    """`volume_loss` in plain PyTorch, any dtype and device: the oracle."""
    if len(scales) == 0:
        return scales.sum()
    return scales.prod(dim=1).mean()


def sparsity_loss(mask_logits: Tensor, live: Tensor, group_weight: float) -> Tensor:
    """Mean σ(m) over live slots plus λ_g times the mean group norm per anchor / √K.

    Both terms lie in [0, 1], so their weights do not depend on the number of anchors
    (methods.md §1.11.5; the paper writes sums).

    Args:
        mask_logits: [V, K] of the anchors in view: others get no push (§1.11.9).
        live: [V, K] bool, slots that are on in the parent.
        group_weight: λ_group.
    """
    soft = mask_logits.sigmoid() * live
    single = soft.sum() / live.sum().clamp(min=1)
    group = (soft.square().sum(dim=1) + 1e-12).sqrt() / live.shape[1] ** 0.5
    return single + group_weight * group.sum() / max(1, len(group))
