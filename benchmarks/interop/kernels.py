"""Our render with another program's kernel: the part of a difference that the kernel explains.

3DGS adds 0.3 square pixels to a splat's variance and draws it as far as its alpha is 1/255.
PlayCanvas and Babylon.js end it at the square root of 8 standard deviations, where an opaque one
still has 0.018; PlayCanvas moreover lowers the kernel so that it is 0 there. Both add 0.3 in pixels
of half the size, which are 0.075 of ours. Their images are 8 bits after every splat; here they
are not.
"""

from collections.abc import Callable, Mapping

import numpy as np
import torch
from numpy.typing import NDArray

from gsynopsis.evaluation.metrics import Image8
from gsynopsis.model.plain import PlainModel
from gsynopsis.records import PlainGaussians
from gsynopsis.render.base import ALPHA_MIN, DILATION
from gsynopsis.render.reference import project
from gsynopsis.scene.camera import Camera

Float64 = NDArray[np.float64]
REACH = 8.0
"""Square of the standard deviations at which those programs end a Gaussian."""
EDGE = float(np.exp(-REACH / 2))


def cut(opacity: float, distance2: Float64) -> Float64:
    """Alpha of Babylon.js, from squared standard deviations."""
    alpha = opacity * np.exp(-0.5 * distance2)
    return np.where((distance2 <= REACH) & (alpha >= ALPHA_MIN), alpha, 0)


def lowered(opacity: float, distance2: Float64) -> Float64:
    """Alpha of a Gaussian as PlayCanvas computes it."""
    alpha = opacity * (np.exp(-0.5 * distance2) - EDGE) / (1 - EDGE)
    return np.where((distance2 <= REACH) & (alpha >= ALPHA_MIN), alpha, 0)


KERNELS: Mapping[str, Callable[[float, Float64], Float64]] = {
    "playcanvas": lowered,
    "babylon": cut,
}


def painted(gaussians: PlainGaussians, camera: Camera, kernel: str, added: float) -> Image8:
    """The Gaussians on black, far to near, colours held at 1 as a screen does.

    Args:
        gaussians: Any number.
        camera: Any.
        kernel: Name of one of `KERNELS`.
        added: To the variance of each along both axes of the image, square pixels.
    """
    with torch.no_grad():
        decoded = PlainModel(gaussians, antialiased=False).decode(camera)
        flat = project(decoded, camera)
    order = torch.argsort(flat.depths, descending=True, stable=True)
    centers = flat.centers[order].double().numpy()
    covariances = flat.covariances[order].double() + (added - DILATION) * torch.eye(2).double()
    forms = torch.linalg.inv(covariances).numpy()
    sizes = np.sqrt(np.diagonal(covariances.numpy(), axis1=1, axis2=2))
    index = flat.index[order]
    opacities = decoded.opacities[index].double().numpy()
    colors = decoded.colors[index].double().clamp(max=1).numpy()
    image = np.zeros((camera.height, camera.width, 3))
    alpha_of, bounds = KERNELS[kernel], np.array([camera.width, camera.height])
    lows = np.clip(np.floor(centers - 3.4 * sizes), 0, bounds).astype(int)
    highs = np.clip(np.ceil(centers + 3.4 * sizes), 0, bounds).astype(int)
    for k in np.flatnonzero((lows < highs).all(axis=1)):
        (left, top), (right, bottom) = lows[k], highs[k]
        dx = np.arange(left, right) + 0.5 - centers[k, 0]
        dy = (np.arange(top, bottom) + 0.5 - centers[k, 1])[:, None]
        form = forms[k]
        distance2 = form[0, 0] * dx * dx + 2 * form[0, 1] * dx * dy + form[1, 1] * dy * dy
        alpha = alpha_of(opacities[k], distance2)[:, :, None]
        area = image[top:bottom, left:right]
        area += alpha * (colors[k] - area)
    return (np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)
