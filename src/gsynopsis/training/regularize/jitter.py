"""Sub-pixel jitter: photos sampled between their pixels, against overfitting the pixels (ours).

A small photo tells only what its pixels are, and a model may show anything between them. The stored
photo, where it is larger, tells that too (methods.md §2.7).
"""

import numpy as np

from gsynopsis.config import Config
from gsynopsis.scene.camera import STILL, Shift
from gsynopsis.scene.scene import Scene

REDUCED = 2.0
"""Photos divided by this or more have something to tell between their pixels."""


def subpixels_of(config: Config) -> int:
    """Places of a pixel along each axis at which this training samples its photos.

    `train.subpixel_jitter`; but 1 where photos are divided by less than `REDUCED`.
    """
    return config.train.subpixel_jitter if config.scale >= REDUCED else 1


def photo_bytes(scene: Scene, config: Config) -> int:
    """All training photos at the training resolution, in all their samplings, bytes."""
    cameras = [scene.camera(view, config.scale) for view in scene.train]
    return subpixels_of(config) ** 2 * sum(3 * c.width * c.height for c in cameras)


def shift_places(subpixels: int) -> list[Shift]:
    """Places of a pixel that steps sample, row by row, -0.5 to 0.5 pixels; for 1 the centre."""
    if subpixels == 1:
        return [STILL]
    along = ((np.arange(subpixels) + 0.5) / subpixels - 0.5).tolist()
    return [(right, down) for right in along for down in along]
