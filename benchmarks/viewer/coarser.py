"""Pictures of a city's coarser levels beside those of its finest, by the size of splats on screen.

    python -m benchmarks.viewer.coarser [--steps 500]

The camera stands where all of the city (benchmarks/viewer/city.py) is in view; pictures become
smaller, and with them the splats. Drawn by the CPU renderer. A viewer may draw a coarser level
instead of the finest where nobody sees it: at 45 dB, say.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from benchmarks.bench import RUNS, machine, short_commit
from benchmarks.viewer.browser import psnr
from benchmarks.viewer.city import files_of
from gsynopsis.container.reader import decode
from gsynopsis.jobs.splat_views import painted
from gsynopsis.model.splats import SplatModel, decoder_of
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import Camera, look_at

PARTS = (1, 2, 4, 8)
"""Divisors of the picture's size."""


@dataclass(frozen=True)
class Options:
    """Options of the measurement.

    Attributes:
        splats: Splats of the city.
        steps: Of training coarse levels; 0: they are splats of the city.
        width: Width of the largest picture, pixels.
        height: Its height, pixels.
        out: Folder in which files stay; existing files are not made again.
    """

    splats: int = 200_000
    steps: int = 0
    width: int = 320
    height: int = 180
    out: Path = RUNS / "city"


def camera_of(width: int, height: int) -> Camera:
    """A camera with all of the city in view, 55 degrees along the shorter side."""
    focal = min(width, height) / 2 / np.tan(np.deg2rad(55) / 2)
    place = np.array([15.0, -18.0, -26.0])
    w2c = look_at(place, np.zeros(3), np.array([0.0, -1.0, 0.0]))
    return Camera(width, height, focal, focal, width / 2, height / 2, w2c)


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    _, ours = files_of(options.splats, options.out, options.steps)
    model = decoder_of(decode(ours.read_bytes(), str(ours)))
    assert isinstance(model, SplatModel)
    finest = len(model.parts) - 1
    shown = model.part(-1).mask[:, 0]
    sizes = np.sort(model.log_scales[shown].exp().numpy(), axis=1)[:, 1]
    names = " | ".join(f"L{level}, dB" for level in range(finest))
    print(f"| picture | median splat, px | {names} |", "|---" * (finest + 2) + "|", sep="\n")
    for part in PARTS:
        camera = camera_of(options.width // part, options.height // part)
        pictures = [
            painted(model, level, camera, CpuRenderer()) / 255 for level in range(finest + 1)
        ]
        size = float(np.median(sizes)) * camera.fx / float(np.linalg.norm(camera.position))
        values = " | ".join(f"{psnr(picture, pictures[finest]):.1f}" for picture in pictures[:-1])
        print(f"| {camera.width} x {camera.height} | {size:.2f} | {values} |")
    print(f"{options.splats:,} splats, {machine().cpu}, commit {short_commit()}")


if __name__ == "__main__":
    main()
