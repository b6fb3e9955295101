"""Renders by the browser in windows smaller than the training photos, beside held-out photos.

    python -m benchmarks.viewer.small_windows --run RUN --scene SCENE

Each held-out photo is reduced to the window, and the viewer renders its view there in Chromium:
while the camera moves, with opacity compensation; at rest, rendered larger and reduced; and as
`evaluate` renders it. Rows go into docs/results/small_windows.csv.
"""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro

from benchmarks.bench import RESULTS, Row, machine, short_commit, write_rows
from benchmarks.viewer.browser import MISSING, pages, pinhole, pixels, psnr, screenshot, visit
from gsynopsis.evaluation.load_model import Opened, open_levels
from gsynopsis.evaluation.protocols import LevelRenderer
from gsynopsis.runs.folder import read_run
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene

CSV = RESULTS / "small_windows.csv"
PARTS = (1, 2, 4, 8)
"""Windows, in parts of the photos of training."""


@dataclass(frozen=True)
class Options:
    """Options of the comparison.

    Attributes:
        run: A finished run.
        scene: Its scene's folder.
        views: Held-out views, from the first.
    """

    run: Path
    scene: Path
    views: int = 4


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    if MISSING:
        raise SystemExit(f"small_windows: no {MISSING}")
    record = read_run(options.run)
    assert record.scale is not None
    scene = load_scene(options.scene, "every8")
    opened = open_levels(record.file, "cpu")
    rows = list[Row]()
    for part in PARTS:
        for level in (0, len(opened.levels.levels) - 1):
            views = scene.test[: options.views]
            found = [
                shown(record.file, opened, scene, (view, part * record.scale, level))
                for view in views
            ]
            rows.append({
                "scene": options.scene.name, "preset": record.preset, "level": level,
                "part": f"1/{part}", "views": len(found),
                **{way: round(float(np.mean([each[way] for each in found])), 2)
                   for way in ("moving", "rest", "evaluate")},
                "commit": short_commit(), "machine": machine().cpu,
            })  # fmt: skip
            print(rows[-1])
    write_rows(CSV, rows)


def shown(
    file: Path, opened: Opened, scene: Scene, seen: tuple[int, float, int]
) -> dict[str, float]:
    """PSNR of a view against its photo, dB, at a scale, of a level."""
    view, scale, level = seen
    camera, photo = scene.camera(view, scale), scene.image(view, scale) / 255
    steps: list[dict[str, Any]] = [
        {"wait": "complete"},
        {"name": "moving", "script": f"picture({pinhole(camera)}, {level})"},
        {"name": "_", "script": f"viewer().scene.setPinhole({pinhole(camera)})"},
        {"sleep": 1500},
        {"shot": "rest"},
    ]
    painter = LevelRenderer(opened.decoder, opened.renderer)
    with tempfile.TemporaryDirectory() as folder, pages(file) as address:
        place = Path(folder)
        found = visit(f"{address}/?noui", place, steps, (camera.width, camera.height))
        rest = screenshot(place / "rest.png")
    with torch.no_grad():
        painted = painter.paint(camera, level) / 255
    moving = pixels(found.results["moving"])
    return {
        "moving": psnr(moving, photo),
        "rest": psnr(rest, photo),
        "evaluate": psnr(painted, photo),
    }


if __name__ == "__main__":
    main()
