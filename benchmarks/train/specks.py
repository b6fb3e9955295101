"""Dark holes and white specks of each level: pixels far from all that the photo shows around them.

    python -m benchmarks.train.specks --runs runs/scenes/fox-fast runs/scenes/bonsai-fast
    python -m benchmarks.train.specks --runs runs/scenes/bonsai-fast --train  # photos of training

Level k of n is compared at the run's scale. *Blurred*: the image's brightness is over 0.25 below
(above) the photo's after a Gaussian blur of the level's scale, σ = 2^(n − 1 − k) / 2 pixels. That
counts sharp edges too, so *beyond*: it is over 0.1 below (above) all that the photo has within four
pixels. *Open*: less than nine tenths of the pixel are covered, and the background shows through.
Prints CSV: means over views, dB and shares of pixels in per mille. With `--page` it goes into
docs/results/specks.csv as well, a line into robustness.md, and a strip of the last run's pictures
beside it.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from benchmarks.bench import RESULTS, Row, machine, put, short_commit, write_rows
from gsynopsis.evaluation.evaluate import evenly
from gsynopsis.evaluation.load_model import Opened, open_levels
from gsynopsis.evaluation.metrics import Image8, psnr, to_bytes
from gsynopsis.render.base import Rendering
from gsynopsis.runs.folder import read_run
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.load import load_scene

BLURRED, BEYOND = 0.25, 0.1
"""Differences of brightness, [0, 1], from which a pixel counts."""
AROUND = 4
"""Radius of what the photo shows around a pixel, pixels."""
SHOWN = 2
"""Photos of the strip."""
PAGE, STRIP = RESULTS / "robustness.md", RESULTS / "specks.jpg"
CSV = RESULTS / "specks.csv"
OPEN = 0.9
"""Least alpha of a pixel that counts as covered."""
COLUMNS = ("psnr", "blurred_dark", "blurred_bright", "beyond_dark", "beyond_bright", "open")


@dataclass(frozen=True)
class Options:
    """Options of the measurement.

    Attributes:
        runs: Folders of finished runs.
        train: Use training photos instead of held-out ones.
        views: Number of views, evenly spread.
        page: Write the page.
    """

    runs: tuple[Path, ...]
    train: bool = False
    views: int = 12
    page: bool = False


def main() -> None:
    options, rows = tyro.cli(Options, description=__doc__), list[Row]()
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
        height, width = photos[0].shape[:2]
        for level in range(count):
            drawn = [draw(opened, camera, level) for camera in cameras]
            found = [measure(*pair, count - 1 - level) for pair in zip(drawn, photos, strict=True)]
            values = [round(float(v), 3) for v in np.mean(found, axis=0)]
            print(folder.name, level, *values, sep=",", flush=True)
            facts: Row = {"run": folder.name, "photos": len(views)}
            facts |= {"width": width, "height": height, "level": level}
            rows.append(facts | dict(zip(COLUMNS, values, strict=True)))
        if options.page and folder == options.runs[-1]:
            few = evenly(range(len(cameras)), SHOWN)
            strip(opened, [cameras[i] for i in few], [photos[i] for i in few]).save(STRIP)
    if options.page:
        write_rows(CSV, rows)
        put(PAGE, __file__, text_of(rows, options))


def strip(opened: Opened, cameras: list[Camera], photos: list[Image8]) -> Image.Image:
    """Photo, coarsest and finest level side by side, a row for each camera."""
    rows = [
        np.hstack([photo, *(to_bytes(draw(opened, camera, k).image) for k in (0, -1))])
        for camera, photo in zip(cameras, photos, strict=True)
    ]
    return Image.fromarray(np.vstack(rows))


def text_of(rows: list[Row], options: Options) -> str:
    """Pixels beyond all that the photo shows, level by level, the strip, and what made them."""
    parts: list[str] = []
    for run in dict.fromkeys(row["run"] for row in rows):
        own = [row for row in rows if row["run"] == run]
        first = own[0]
        dark, bright = (
            " / ".join(f"{row[f'beyond_{name}']:.3f}" for row in own) for name in ("dark", "bright")
        )
        parts.append(
            f"{run}, {first['photos']} photos of {first['width']} × {first['height']}: "
            f"{dark} too dark, {bright} too bright"
        )
    kind = "training" if options.train else "test"
    facts = f"Photos of {kind}; {machine().cpu}, commit {short_commit()}; the strip is of "
    facts += f"{options.runs[-1].name}: photo, coarsest level, finest level."
    told = f"Per mille of the pixels, L0 to L{rows[-1]['level']}: {'; '.join(parts)}."
    return f"![{facts}]({STRIP.name})\n\n{told}\n\n{facts}"


def draw(opened: Opened, camera: Camera, level: int) -> Rendering:
    """A level before black."""
    with torch.no_grad():
        gaussians = opened.decoder.decode(camera, level)
        return opened.renderer.render(gaussians, camera, torch.zeros(3))


def measure(drawn: Rendering, photo: Image8, below: int) -> list[float]:
    """The columns of one image of a level `below` steps under the finest."""
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
