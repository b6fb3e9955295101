"""Dark holes and white specks of each level: pixels far from all that the photo shows around them.

    python -m benchmarks.train.specks --runs runs/scenes/fox-fast runs/scenes/bonsai-fast
    python -m benchmarks.train.specks --runs runs/scenes/bonsai-fast --train  # photos of training

Level k of n is compared at the run's scale. *Blurred*: the picture's brightness is over 0.25 below
(above) the photo's after a Gaussian blur of the level's scale, σ = 2^(n − 1 − k) / 2 pixels. That
counts sharp edges too, so *beyond*: it is over 0.1 below (above) all that the photo has within four
pixels. *Open*: less than nine tenths of the pixel are covered, and the background shows through.
Prints CSV: means over views, dB and shares of pixels in per mille.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from numpy.typing import NDArray
from scipy import ndimage

from gsynopsis.evaluation.metrics import Image8, psnr, to_bytes
from gsynopsis.evaluation.opened import Opened, open_levels
from gsynopsis.evaluation.run import evenly
from gsynopsis.pipeline.runs import read_run
from gsynopsis.render.base import Rendering
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.scene import load_scene

BLURRED, BEYOND = 0.25, 0.1
"""Differences of brightness, [0, 1], from which a pixel counts."""
AROUND = 4
"""Radius of what the photo shows around a pixel, pixels."""
OPEN = 0.9
"""Least alpha of a pixel that counts as covered."""
COLUMNS = ("psnr", "blurred_dark", "blurred_bright", "beyond_dark", "beyond_bright", "open")


@dataclass(frozen=True)
class Options:
    """What to measure.

    Attributes:
        runs: Folders of finished runs.
        train: On photos of training instead of those held out.
        views: So many of them, evenly spread.
    """

    runs: tuple[Path, ...]
    train: bool = False
    views: int = 12


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    print("run", "level", *COLUMNS, sep=",")
    for folder in options.runs:
        record = read_run(folder)
        if record.scene is None or record.scale is None:
            raise SystemExit(f"specks.py: {folder}: its record names no scene and scale")
        opened, scene = (
            open_levels(record.file, "cpu"),
            load_scene(record.scene, record.split or "every8"),
        )
        views = evenly(scene.train if options.train else scene.test, options.views)
        cameras = [scene.camera(view, record.scale) for view in views]
        photos = [scene.image(view, record.scale) for view in views]
        count = len(opened.levels.levels)
        for level in range(count):
            rows = [
                measure(draw(opened, camera, level), photo, count - 1 - level)
                for camera, photo in zip(cameras, photos, strict=True)
            ]
            print(folder.name, level, *(f"{v:.3f}" for v in np.mean(rows, axis=0)), sep=",")
            sys.stdout.flush()


def draw(opened: Opened, camera: Camera, level: int) -> Rendering:
    """A level before black."""
    with torch.no_grad():
        gaussians = opened.decoder.decode(camera, level)
        return opened.renderer.render(gaussians, camera, torch.zeros(3))


def measure(drawn: Rendering, photo: Image8, below: int) -> list[float]:
    """The columns of one picture of a level `below` steps under the finest."""
    picture = to_bytes(drawn.image)
    found, truth = brightness(picture), brightness(photo)
    soft = ndimage.gaussian_filter(truth, 2**below / 2)
    disc = np.hypot(*np.mgrid[-AROUND : AROUND + 1, -AROUND : AROUND + 1]) <= AROUND
    low, high = (f(truth, footprint=disc) for f in (ndimage.minimum_filter, ndimage.maximum_filter))
    masks = (
        soft - found > BLURRED,
        found - soft > BLURRED,
        low - found > BEYOND,
        found - high > BEYOND,
        drawn.alpha.numpy() < OPEN,
    )
    return [psnr(picture, photo), *(1000 * float(mask.mean()) for mask in masks)]


def brightness(image: Image8) -> NDArray[np.float64]:
    """Mean of the colours, [0, 1], [H, W]."""
    return image.mean(axis=2) / 255


if __name__ == "__main__":
    main()
