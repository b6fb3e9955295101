"""Losses of images and Gaussians in plain PyTorch, any dtype and device, and the masks' sparsity.

`view_step.py` has the native ones, whose oracles these are.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

SSIM_WEIGHT = 0.2
"""λ_SSIM of (1 − λ)·L1 + λ·(1 − SSIM) (paper)."""
SSIM_C1 = 0.01**2
SSIM_C2 = 0.03**2
SSIM_RADIUS = 5
SSIM_SIGMA = 1.5


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


def mean_squared_reference(image: Tensor, target: Tensor) -> Tensor:
    """`mean_squared_error` in plain PyTorch, any dtype and device: the oracle."""
    with torch.no_grad():
        return (image - target).square().mean().double()


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
