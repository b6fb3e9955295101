"""Images much smaller than those of training: rendered larger, then reduced (methods.md §2.11)."""

import math

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from gsynopsis.render.base import ANTIALIASED, Gaussians, Renderer
from gsynopsis.scene.camera import Camera

SUPERSAMPLING_MAX = 16
"""Largest factor: a scene that needs more is only a few pixels wide."""
PIXELS_MAX = 1 << 22
"""Most pixels of the larger render: a note in a file must not cost memory."""


def supersampling(gaussians: Gaussians, camera: Camera) -> int:
    """Factor by which an image is rendered larger before it is reduced; 1: not at all.

    With it the render is about as large as the training images: opacity compensation Gaussian by
    Gaussian (`low_pass_filter`) opens surfaces that many small ones cover together, and the look of
    a scene is known at training resolution (ours, methods.md §2.11).
    """
    if gaussians.focals is None or gaussians.focals[0] >= ANTIALIASED[0]:
        return 1  # nothing is known of training, or it was with fading
    times = round(gaussians.focals[0] / camera.focal_length)
    pixels = camera.width * camera.height
    return min(max(1, times), SUPERSAMPLING_MAX, max(1, math.isqrt(PIXELS_MAX // pixels)))


def render_reduced(
    renderer: Renderer, gaussians: Gaussians, camera: Camera, background: Tensor
) -> Tensor:
    """An image for eyes, [H, W, 3]: one that is much smaller than those of training is reduced.

    By the filter of the photos (Lanczos), from a rendering `supersampling` times as large. Not
    differentiable. Values may lie outside of [0, 1], as those of any sharp filter.

    Args:
        renderer: Renders.
        gaussians: Of this camera; the frustum is the same at any size.
        camera: Of the image that is wanted.
        background: [3].
    """
    times = supersampling(gaussians, camera)
    if times == 1:
        return renderer.render(gaussians, camera, background).image
    large = camera.resized(camera.width * times, camera.height * times)
    image = renderer.render(gaussians, large, background).image.detach()
    size = (camera.width, camera.height)
    channels = [
        np.asarray(Image.fromarray(channel).resize(size, Image.Resampling.LANCZOS))
        for channel in image.clamp(0, 1).permute(2, 0, 1).float().cpu().numpy()
    ]
    return torch.from_numpy(np.stack(channels, axis=2)).to(image)
