"""Quality of a scene in images larger and smaller than the photos it was trained on.

    python -m benchmarks.train.picture_sizes

Draws held-out views of finished runs (runs/scenes) at sizes from the photo's own down: as the file
says (`focals`), small images rendered larger and reduced; with fading alone, as the browser draws
them; and as if the file said nothing. Rows go into
docs/results/picture_sizes.csv, a line and a picture into ablations.md.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import tyro
from PIL import Image

import benchmarks.bench as bench
from benchmarks.bench import DATA, RESULTS, Row, machine, put, short_commit, write_rows
from gsynopsis.evaluation.load_model import open_levels
from gsynopsis.evaluation.metrics import Image8, psnr, to_bytes
from gsynopsis.evaluation.protocols import LevelRenderer
from gsynopsis.model.build import model_from_levels
from gsynopsis.records import FOCALS_NOTE
from gsynopsis.runs.folder import read_run
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene

RUNS = bench.RUNS / "scenes"
PAGE, CSV = RESULTS / "ablations.md", RESULTS / "picture_sizes.csv"
TIMES = (4.0, 2.0, 1.0, 0.5, 0.25, 0.125)
"""Sizes of images, in sizes of the photos of training."""
CROP = 300
"""Pixels of each part of the picture."""


@dataclass(frozen=True)
class Options:
    """Options of the comparison.

    Attributes:
        data: Folder that holds the scenes.
        runs: Runs of runs/scenes.
        views: Held-out views of each, from the first.
    """

    data: Path = DATA
    runs: tuple[str, ...] = ("fox-fast", "fox-sequential", "bonsai-fast")
    views: int = 6


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    rows = list[Row]()
    for run in options.runs:
        told, faded, untold, scene, scale = painters(run, options.data)
        drawn = {"as trained": told, "faded": faded, "without": untold}
        views = list(scene.test)[: options.views]
        for level in (0, 3):
            for name, painter in drawn.items():
                found = [mean_psnr(painter, scene, views, scale / t, level) for t in TIMES]
                values = ("" if value is None else round(value, 2) for value in found)
                row: Row = {"run": run, "level": level, "drawn": name}
                rows.append(row | dict(zip(SIZES, values, strict=True)))
    draw_picture(options)
    what = "Photo, as trained, without; at four times and at a quarter of the size of training"
    cpu = machine().cpu
    made = f"First {options.views} held-out views, seed 0, {cpu}, commit {short_commit()}."
    write_rows(CSV, rows)
    put(PAGE, __file__, f"![{what}](picture_sizes.png)\n\n{text_of(rows)}\n\n{made}")
    print(f"wrote {PAGE}, {CSV} and {RESULTS / 'picture_sizes.png'}")


SIZES = tuple(f"{times:g}x" for times in TIMES)
"""Columns of the sizes."""


def text_of(rows: list[Row]) -> str:
    """The finest level of each run at the largest size and at a quarter, dB."""
    parts: list[str] = []
    for run in dict.fromkeys(row["run"] for row in rows):
        own = {row["drawn"]: row for row in rows if row["run"] == run and row["level"] == 3}
        cells = (f"{name} {row['4x']:.2f} and {row['0.25x']:.2f}" for name, row in own.items())
        parts.append(f"{run} {', '.join(cells)}")
    return f"Finest level at four times and at a quarter of the size, dB: {'; '.join(parts)}."


class Faded(LevelRenderer):
    """Draws small images as they are, by the fading of each Gaussian."""

    def paint(self, camera: Camera, level: int) -> Image8:
        """As `LevelRenderer.paint`."""
        gaussians = self.decoder.decode(camera, level)
        return to_bytes(self.renderer.render(gaussians, camera, self.background).image)


def painters(
    run: str, data: Path
) -> tuple[LevelRenderer, LevelRenderer, LevelRenderer, Scene, float]:
    """A run's file drawn as it says, by fading, as if it said nothing; its scene and scale."""
    record = read_run(RUNS / run)
    opened = open_levels(record.file, "cpu")
    meta = {name: text for name, text in opened.levels.meta.items() if name != FOCALS_NOTE}
    silent = replace(opened.levels, meta=meta)
    told = LevelRenderer(opened.decoder, opened.renderer)
    faded = Faded(opened.decoder, opened.renderer)
    untold = LevelRenderer(model_from_levels(silent), opened.renderer)
    scene = load_scene(data / run.split("-")[0], "every8")
    assert record.scale is not None
    return told, faded, untold, scene, record.scale


def mean_psnr(
    painter: LevelRenderer, scene: Scene, views: list[int], scale: float, level: int
) -> float | None:
    """Over some views, for photos divided by `scale`; None if photos are not so large."""
    if scale < 1:
        return None
    with torch.no_grad():
        return float(np.mean([
            psnr(painter.paint(scene.camera(view, scale), level), scene.image(view, scale))
            for view in views
        ]))  # fmt: skip


def draw_picture(options: Options) -> None:
    """Cut-outs of one view: the photo, as trained, without; large above, small below."""
    told, _, untold, scene, scale = painters(options.runs[-1], options.data)
    view, rows = scene.test[0], list[Image8]()
    for times in (4.0, 0.25):
        camera = scene.camera(view, scale / times)
        with torch.no_grad():
            images = [
                scene.image(view, scale / times),
                *(p.paint(camera, 3) for p in (told, untold)),
            ]
        rows.append(np.concatenate([cut_out(image) for image in images], axis=1))
    Image.fromarray(np.concatenate(rows)).quantize(256).save(RESULTS / "picture_sizes.png")


def cut_out(image: Image8) -> Image8:
    """CROP × CROP pixels: the middle of a large image, a small one enlarged pixel by pixel."""
    height, width = image.shape[:2]
    zoom = max(1, -(-CROP // min(height, width)))
    large = image.repeat(zoom, axis=0).repeat(zoom, axis=1)
    top, left = (large.shape[0] - CROP) // 2, (large.shape[1] - CROP) // 2
    return large[top : top + CROP, left : left + CROP]


if __name__ == "__main__":
    main()
