"""PSNR, SSIM and FLIP as the plain evaluator computes them, and the door for LPIPS.

Every measure takes two 8-bit images. Renderings are clamped and rounded to 8 bits first, because
the numbers in the literature are measured on saved PNGs (methods.md §3.4).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from gsynopsis.errors import DivergedError

Image8 = NDArray[np.uint8]
"""An image, sRGB, uint8 [H, W, 3]."""

PSNR_CAP = 100.0
"""dB; what identical images get. The truth is infinite, which neither a mean nor JSON can hold."""
WINDOW = 11
"""Taps of the SSIM window per axis; the window is Gaussian."""
SIGMA = 1.5
"""Standard deviation of the SSIM window, pixels."""
STRIP = 256
"""Rows that PSNR compares at once."""
CPU = torch.device("cpu")
C1 = 0.01**2
C2 = 0.03**2


@dataclass(frozen=True)
class LearntMeasure:
    """A perceptual distance such as LPIPS, supplied by the user with its weights.

    No package ships the weights (methods.md §3.4), so without one the reports say "n/a".

    Attributes:
        name: Network and normalisation, e.g. `lpips vgg [0,1]`; printed beside the numbers,
            because those of different networks cannot be compared.
        distance: Two images of one size to a number, lower is better.
    """

    name: str
    distance: Callable[[Image8, Image8], float]


def to_bytes(image: Tensor) -> Image8:
    """A rendering [H, W, 3] clamped to [0, 1] and rounded to 8 bits, as a saved PNG holds it.

    Raises:
        DivergedError: a pixel is not finite.
    """
    if not bool(torch.isfinite(image).all()):
        raise DivergedError("a rendered image holds values that are not finite")
    scaled = image.detach().clamp(0.0, 1.0).mul_(255.0).round_()
    return scaled.to(device="cpu", dtype=torch.uint8).numpy()


def psnr(image: Image8, truth: Image8) -> float:
    """Peak signal-to-noise ratio over all pixels and channels on [0, 1], dB, at most PSNR_CAP.

    On the host: 5 ms a megapixel.
    """
    _expect_same_size(image, truth)
    squares = 0
    # By strips: a photo of 12 megapixels in float64 is 300 MB, three times over.
    for top in range(0, len(image), STRIP):
        rows = slice(top, top + STRIP)
        difference = image[rows].astype(np.int32) - truth[rows]
        squares += int(np.square(difference).sum(dtype=np.int64))
    error = squares / image.size / 255.0**2
    if error == 0.0:
        return PSNR_CAP
    return min(PSNR_CAP, -10.0 * float(np.log10(error)))


def flip(image: Image8, truth: Image8) -> float | None:
    """LDR-FLIP (Andersson and others, 2020) at 67 pixels a degree: 0 for identical images, up to 1.

    None where flip-evaluator is not installed, which has no wheel for every machine.
    """
    _expect_same_size(image, truth)
    try:
        import flip_evaluator  # pyright: ignore[reportMissingTypeStubs]
    except ImportError:
        return None
    library: Any = flip_evaluator
    reference, test = (one.astype(np.float32) / 255 for one in (truth, image))
    return float(library.evaluate(reference, test, "LDR", applyMagma=False)[1])


def ssim(image: Image8, truth: Image8, device: torch.device = CPU) -> float:
    """Structural similarity, the mean of `ssim_map`: 1 for identical images."""
    return float(ssim_map(image, truth, device).mean())


def ssim_map(image: Image8, truth: Image8, device: torch.device = CPU) -> Tensor:
    """Structural similarity of each pixel and channel, float64 [3, H, W] on `device`.

    An 11 × 11 Gaussian window with σ = 1.5 and zeros outside the image, on [0, 1], without
    cropping the border: the form of the 3DGS family.
    """
    _expect_same_size(image, truth)
    x, y = _planes(image, device), _planes(truth, device)
    # One after the other: all five of a photo would not fit a processor's cache.
    blurred = [_blur(planes) for planes in (x, y, x * x, y * y, x * y)]
    mean_x, mean_y = blurred[0], blurred[1]
    var_x, var_y = blurred[2] - mean_x * mean_x, blurred[3] - mean_y * mean_y
    covariance = blurred[4] - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + C1) / (mean_x * mean_x + mean_y * mean_y + C1)
    structure = (2 * covariance + C2) / (var_x + var_y + C2)
    return luminance * structure


def _planes(image: Image8, device: torch.device) -> Tensor:
    """The channels on [0, 1], float64 [3, H, W]."""
    return torch.tensor(image).to(device).permute(2, 0, 1).double().div(255.0)


def _blur(planes: Tensor) -> Tensor:
    """The Gaussian window over the last two axes, one after the other.

    Eleven shifted sums each: four times faster than `conv2d`, which is slow in float64.
    """
    # On the host: every device is given the same eleven numbers.
    taps = torch.arange(WINDOW, dtype=torch.float64) - WINDOW // 2
    kernel = torch.exp(-taps * taps / (2 * SIGMA * SIGMA))
    weights = [float(weight) for weight in kernel / kernel.sum()]
    for axis, padding in ((-2, (0, 0, WINDOW // 2, WINDOW // 2)), (-1, (WINDOW // 2,) * 2)):
        padded, length = functional.pad(planes, padding), planes.shape[axis]
        planes = torch.zeros_like(planes)
        for shift, weight in enumerate(weights):
            planes.add_(padded.narrow(axis, shift, length), alpha=weight)
    return planes


def _expect_same_size(image: Image8, truth: Image8) -> None:
    if image.shape != truth.shape:
        raise ValueError(f"images of {image.shape} and {truth.shape} cannot be compared")
