"""`gsynopsis evaluate`: quality, size and speed of a run on its held-out photos."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from gsynopsis.cli.bounds import Backend, bounded, with_training
from gsynopsis.cli.defaults import said
from gsynopsis.cli.report import print_report
from gsynopsis.config import Split
from gsynopsis.runs.folder import find_run, scene_of

MEGAPIXELS = (0, 1_000_000)
FRAMES = (1, 1000)
"""To time per level."""


@dataclass(frozen=True)
class Evaluate:
    """Measure a run on its held-out photos: table, metrics.json, CSV, contact sheet, HTML report.

    Attributes:
        run_path: Folder of a run, or a .gsyn file together with --scene and --scale.
        scene: Folder of the scene.
        scale: Divide the photos' width and height by this.
        split: Rule that chooses the held-out photos.
        out: Folder for the results.
        renderer: Rasteriser; auto takes CUDA where it is there.
        frames: Frames to time per level.
        photo_megapixels: Measure also at the photos' own size, rendering at most so many million
            pixels (250 take minutes on a CPU, and are as many held-out photos, evenly chosen, as
            fit); 0 leaves it out.
        popping: Measure also how much a switch of levels is seen, at once and faded.
        exposure: Measure also the right half of each photo after the left half told its exposure.
        lpips: Measure LPIPS too, by the weights in this file: the state dict of `lpips.LPIPS`,
            network vgg or alex, as torch.save writes it.
        json: Print metrics.json instead of the table.
        quiet: No progress.
    """

    run_path: Positional[Path]
    scene: Annotated[Path | None, said("the run's")] = None
    scale: Annotated[float | None, said("the run's")] = None
    split: Annotated[Split | None, said("the run's, else every8")] = None
    out: Annotated[Path | None, said("the run's folder")] = None
    renderer: Backend = "auto"
    frames: int = 20
    photo_megapixels: float = 250.0
    popping: bool = False
    exposure: bool = False
    lpips: Annotated[Path | None, said("none")] = None
    json: bool = False
    quiet: bool = False

    def run(self) -> int:
        """Evaluate, write the report, print."""
        run = find_run(self.run_path)
        bounded("--frames", self.frames, *FRAMES)
        bounded("--photo-megapixels", self.photo_megapixels, *MEGAPIXELS)
        scene, scale, split = scene_of(run, self.scene, self.scale, self.split)
        # As of trainings: a smaller one would enlarge the photos, beyond all memory.
        scale = bounded("--scale", scale, 1, 65_536)
        with with_training():
            from gsynopsis.evaluation.lpips import load_lpips
            from gsynopsis.evaluation.report_files import write_report
            from gsynopsis.jobs.evaluate import Measures, evaluate
            from gsynopsis.monitor.display import ticking
            from gsynopsis.render.choose import make_renderer
        pixels = round(self.photo_megapixels * 1e6)
        device = make_renderer(self.renderer).device
        lpips = load_lpips(self.lpips, device) if self.lpips else None
        measures = Measures(
            self.frames, pixels, self.popping, self.renderer, self.exposure, lpips=lpips
        )
        with ticking("evaluating views", quiet=self.quiet) as tick:
            report = evaluate(run, scene, scale, split, measures, tick=tick)
        if not self.quiet:
            print(report.account.text(), file=sys.stderr)
        folder = self.out or run.folder
        written = write_report(report, folder)
        print_report(report, folder, as_json=self.json)
        if written.notes and not self.json:
            print("\n".join(written.notes))
        return 0
