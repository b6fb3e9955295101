"""`gsynopsis evaluate`: quality, size and speed of a run on its held-out photos."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional

from gsynopsis.cli.defaults import said
from gsynopsis.cli.opening import Backend, Opened, Split, bounded, open_file, positive
from gsynopsis.cli.orbit import circle_of_levels, default_lens, orbit
from gsynopsis.cli.progress import ticking
from gsynopsis.cli.run_folder import find_run, scene_of

if TYPE_CHECKING:
    from gsynopsis.evaluate.report import Facts, Report
    from gsynopsis.records import LevelSet
    from gsynopsis.scene.camera import Camera
    from gsynopsis.scene.scene import Scene

MEGAPIXELS = (0, 1_000_000)
FRAMES = (1, 1000)
"""To time per level."""
FLIGHT_WIDTH = 320
"""Pixels of the pictures in which a switch of levels is looked at."""


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
        photo_megapixels: Measure also at the photos' own size, drawing at most so many million
            pixels (250 take minutes on a CPU, and are as many held-out photos, evenly chosen, as
            fit); 0 leaves it out.
        popping: Measure also how much a switch of levels is seen, at once and faded.
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
    json: bool = False
    quiet: bool = False

    def run(self) -> int:
        """Evaluate, write, print."""
        run = find_run(self.run_path)
        bounded("--frames", self.frames, *FRAMES)
        bounded("--photo-megapixels", self.photo_megapixels, *MEGAPIXELS)
        root, scale, split = scene_of(run, self.scene, self.scale, self.split)
        scale = positive("--scale", scale)
        opened = open_file(run.file, self.renderer)
        from gsynopsis.evaluate.phrases import report_table
        from gsynopsis.evaluate.report import Facts, report_json
        from gsynopsis.evaluate.write import write_report
        from gsynopsis.scene.scene import load_scene

        scene = load_scene(root, split)
        facts = Facts(run.preset, run.seed, run.steps, run.train_seconds, split)
        report = self._measure(opened, scene, scale, facts)
        if self.run_path.is_dir():
            gains = self._gains(run.file, opened, scene, scale)
            report = note_quality(run.file, report, gains)
        written = write_report(report, self.out or run.folder)
        if self.json:
            print(report_json(report), end="")
            return 0
        print(report_table(report))
        print("\n".join([*map(str, written.files), *written.notes]))
        return 0

    def _measure(self, opened: "Opened", scene: "Scene", scale: float, facts: "Facts") -> "Report":
        """The report, switches of levels included if they are wanted."""
        from gsynopsis.evaluate.base import Options
        from gsynopsis.evaluate.run import evaluate

        with ticking("evaluating views", quiet=self.quiet) as tick:
            options = Options(
                frames=self.frames,
                facts=facts,
                tick=tick,
                photo_pixels=round(self.photo_megapixels * 1e6),
            )
            report = evaluate(opened.decoder, opened.levels, scene, opened.renderer, scale, options)
        if not self.popping:
            return report
        from gsynopsis.evaluate.popping import measure_switches

        switches = measure_switches(opened.levels, smooth_flight(opened.levels), opened.renderer)
        return replace(report, switches=switches)

    def _gains(self, file: Path, opened: "Opened", scene: "Scene", scale: float) -> str:
        """What each block adds, for the file's own notes; empty where there is no choice."""
        from gsynopsis.evaluate.gains import cameras_of, measure_gains
        from gsynopsis.pack import Assembler
        from gsynopsis.pack.edit import read_bytes
        from gsynopsis.pack.gains import gains_text

        data = read_bytes(file)
        assembler = Assembler(data, str(file))
        levels = assembler.index.levels
        if max(level.blocks for level in levels) == 1 or levels[-1].end != len(data):
            return ""
        for _ in levels:
            assembler.add_level(data)
        with ticking("measuring blocks", quiet=self.quiet) as tick:
            cameras = cameras_of(scene, scale)
            return gains_text(measure_gains(assembler, cameras, opened.renderer, tick))


def smooth_flight(levels: "LevelSet") -> "list[Camera]":
    """As many frames of a round of 48 seconds, 30 a second, as a fade needs and one more."""
    from gsynopsis.model.mixed import FADE_FRAMES

    lens = default_lens().scaled(default_lens().width / FLIGHT_WIDTH)
    return orbit(circle_of_levels(levels), lens, 48 * 30)[: FADE_FRAMES + 1]


def note_quality(file: Path, report: "Report", gains: str = "") -> "Report":
    """Put the measured quality of each level, and how it was measured, into the file.

    Args:
        file: What was measured.
        report: Of it.
        gains: What its blocks add, as `pack.gains` writes it; empty if nobody measured it.

    Returns:
        The report with the sizes that the file has then.
    """
    from gsynopsis.pack import annotate, describe
    from gsynopsis.pack.gains import META

    if describe(file).levels_total != len(report.levels):
        return report
    figures = [
        {k: round(v, 5) for k, v in asdict(score.quality).items() if v is not None}
        for score in report.levels
    ]
    notes = {"protocol": report_protocol(report), "pictures": f"{report.width} x {report.height}"}
    notes |= {META: gains} if gains else {}
    annotate(file, notes, figures)
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
    full, photo = f"{report.width} x {report.height}", report.photo
    text = (
        f"held-out views by rule {split}, scale {report.scale:g}, 8 bits, black background; "
        f"full: pictures of {full}, own: {report.levels[0].own_size[0]} x "
        f"{report.levels[0].own_size[1]} to {full}, by level"
    )
    if photo is None:
        return text
    some = f"{photo.views} of {photo.held_out} views"
    return f"{text}, photo: {photo.width} x {photo.height}, the photos' own size, {some}"
