"""`gsynopsis evaluate`: quality, size and speed of a run on its held-out photos."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from gsynopsis.cli.opening import Backend, Split, open_file, positive
from gsynopsis.cli.progress import ticking
from gsynopsis.cli.run_folder import Run, find_run, scene_of
from gsynopsis.errors import SettingError

if TYPE_CHECKING:
    from gsynopsis.evaluate.report import Report


@dataclass(frozen=True)
class Evaluate:
    """Measure a run on its held-out photos: table, metrics.json, CSV, contact sheet, HTML report.

    Attributes:
        run_path: Folder of a run, or a .gsyn file together with --scene and --scale.
        scene: Folder of the scene; a run knows its own.
        scale: Divide the photos' width and height by this; a run knows its own.
        split: Rule that chooses the held-out photos; a run knows its own.
        out: Folder for the results; the run's own if not given.
        renderer: Rasteriser; auto takes CUDA where it is there.
        frames: Frames to time per level.
        json: Print metrics.json instead of the table.
        quiet: No progress.
    """

    run_path: Positional[Path]
    scene: Path | None = None
    scale: float | None = None
    split: Split | None = None
    out: Path | None = None
    renderer: Backend = "auto"
    frames: int = 20
    json: bool = False
    quiet: bool = False

    def run(self) -> int:
        """Evaluate, write, print."""
        run = find_run(self.run_path)
        report = self._measure(run)
        from gsynopsis.evaluate.phrases import report_table
        from gsynopsis.evaluate.report import report_json
        from gsynopsis.evaluate.write import write_report

        if self.run_path.is_dir():
            report = note_quality(run.file, report)
        written = write_report(report, self.out or run.folder)
        if self.json:
            print(report_json(report), end="")
            return 0
        print(report_table(report))
        print("\n".join([*map(str, written.files), *written.notes]))
        return 0

    def _measure(self, run: Run) -> "Report":
        if self.frames < 1:
            raise SettingError("--frames", found=self.frames, expected="at least 1")
        scene, scale, split = scene_of(run, self.scene, self.scale, self.split)
        scale = positive("--scale", scale)
        opened = open_file(run.file, self.renderer)
        from gsynopsis.evaluate.base import Options
        from gsynopsis.evaluate.report import Facts
        from gsynopsis.evaluate.run import evaluate
        from gsynopsis.scene.scene import load_scene

        facts = Facts(run.preset, run.seed, run.steps, run.train_seconds, split)
        with ticking("evaluating views", quiet=self.quiet) as tick:
            return evaluate(
                opened.decoder,
                opened.levels,
                load_scene(scene, split),
                opened.renderer,
                scale,
                Options(frames=self.frames, facts=facts, tick=tick),
            )


def note_quality(file: Path, report: "Report") -> "Report":
    """Put the measured quality of each level, and how it was measured, into the file.

    Returns:
        The report with the sizes that the file has then.
    """
    from gsynopsis.pack import annotate, describe

    if describe(file).levels_total != len(report.levels):
        return report
    figures = [
        {k: round(v, 5) for k, v in asdict(score.quality).items() if v is not None}
        for score in report.levels
    ]
    annotate(file, {"protocol": report_protocol(report)}, figures)
    if file.stat().st_size >= report.levels[-1].sizes.bytes_raw:
        return report  # packed raw: its sizes are not those of the compact coding
    levels = tuple(
        replace(score, sizes=replace(score.sizes, bytes_compact=now.bytes, delta_compact=now.delta))
        for score, now in zip(report.levels, describe(file).levels, strict=True)
    )
    return replace(report, levels=levels)


def report_protocol(report: "Report") -> str:
    """How the figures in a file were measured, as one line."""
    split = report.facts.split or "given"
    return (
        f"held-out views by rule {split}, scale {report.scale:g}, 8 bits, black background; "
        "full: at that scale, own: at the level's own"
    )
