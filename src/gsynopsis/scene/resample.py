"""Photos resampled by cubic convolution to what another camera at their place sees."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gsynopsis._native import _core

ROWS = 64
"""Rows that are resampled at a time: their places fit a processor's cache."""
Source = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Places in a photo of places in the other image, both [n, 2] in pixels, corners at (0, 0)."""


def resample(pixels: NDArray[np.uint8], size: tuple[int, int], source: Source) -> NDArray[np.uint8]:
    """The image of another camera, uint8 [height, width, 3].

    Keys' cubic convolution with a = -1/2 (IEEE TASSP 29, 1981), in float32; beyond its edge the
    photo goes on as its last pixel.

    Args:
        pixels: The photo, [H, W, 3].
        size: Width and height of the image, pixels.
        source: Where the image's pixels lie in the photo.
    """
    width, height = size
    image = np.empty((height, width, 3), np.uint8)
    pixels = np.ascontiguousarray(pixels)
    for top in range(0, height, ROWS):
        strip = image[top : top + ROWS]
        rows = np.arange(top, top + len(strip)) + 0.5
        grid = np.stack(np.meshgrid(np.arange(width) + 0.5, rows), axis=-1).reshape(-1, 2)
        places = source(np.asarray(grid, np.float64)).astype(np.float32)
        _core.sample_cubic(pixels, places, strip.reshape(-1, 3))
    return image
