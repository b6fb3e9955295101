"""A run, or a file and a scene, to a report. Nothing is written but the report itself."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from gsynopsis.cameras.orbit import circle_of_levels, orbit
from gsynopsis.cameras.placement import lens_of
from gsynopsis.evaluation.evaluate import evaluate as evaluate_levels
from gsynopsis.evaluation.load_model import open_levels
from gsynopsis.evaluation.metrics import LearntMeasure
from gsynopsis.evaluation.protocols import Options
from gsynopsis.evaluation.report import Provenance, Report
from gsynopsis.jobs.write_file import with_sizes
from gsynopsis.model.multi_level import FADE_FRAMES
from gsynopsis.monitor.display import ticking
from gsynopsis.playback.popping import measure_switches
from gsynopsis.records import LevelSet
from gsynopsis.render.choose import RendererName
from gsynopsis.runs.folder import Run, find_run, scene_of
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene
from gsynopsis.scene.splits import Split

FLIGHT_WIDTH = 320
"""Pixels of the pictures in which a switch of levels is looked at."""


@dataclass(frozen=True)
class Measures:
    """Options of an evaluation.

    Attributes:
        frames: Frames to time per level.
        photo_pixels: Pixels to render at the photos' own size: as many held-out photos, evenly
            chosen, as fit; 0 leaves it out.
        popping: Measure also how much a switch of levels is seen, at once and faded.
        renderer: Rasteriser.
        exposure: Measure also after the photos' exposure was taken out.
        lpips: A learnt measure, see `gsynopsis.evaluation.lpips.load_lpips`; None measures none.
    """

    frames: int = 20
    photo_pixels: int = 250_000_000
    popping: bool = False
    renderer: RendererName = "auto"
    exposure: bool = False
    lpips: LearntMeasure | None = None


def evaluate(
    run: Run | Path | str,
    scene: Scene | Path | str | None = None,
    scale: float | None = None,
    split: Split | None = None,
    measures: Measures | None = None,
    *,
    tick: Callable[[int, int], None] | None = None,
) -> Report:
    """Quality, size and speed of every level on held-out photos.

    Args:
        run: A run, its folder, or a .gsyn file.
        scene: The scene or its folder; a run knows its own.
        scale: Photos are divided by this; a run knows its own.
        split: Rule that chooses the held-out photos; the run's, else `every8`.
        measures: Options of the measurement.
        tick: Told of views done and views in all; None shows a bar.

    Raises:
        FormatError: the file is damaged.
        SceneError: the scene cannot be used.
        SettingError: neither the run nor the call says the scene or the scale.

    Examples:
        >>> report = gs.evaluate("runs/room")
        >>> report
        Report(scene: 4 levels, 2 views of 96 × 64 pixels)
        >>> all(level.quality.psnr_full > 0 for level in report.levels)
        True
    """
    run = run if isinstance(run, Run) else find_run(Path(run))
    measures = measures or Measures()
    known = scene.root if isinstance(scene, Scene) else scene
    folder, factor, rule = scene_of(run, None if known is None else Path(known), scale, split)
    if not isinstance(scene, Scene):
        scene = load_scene(folder, rule, run.reading)
    opened = open_levels(run.file, measures.renderer)
    provenance = Provenance(run.preset, run.seed, run.steps, run.train_seconds, rule)
    with ExitStack() as shown:
        told = tick or shown.enter_context(ticking("evaluating views"))
        options = Options(
            frames=measures.frames,
            provenance=provenance,
            tick=told,
            photo_pixels=measures.photo_pixels,
            exposure=measures.exposure,
            lpips=measures.lpips,
        )
        report = evaluate_levels(
            opened.decoder, opened.levels, scene, opened.renderer, factor, options
        )
    if measures.popping:
        switches = measure_switches(opened.levels, smooth_flight(opened.levels), opened.renderer)
        report = replace(report, switches=switches)
    return with_sizes(report, run.file)


def smooth_flight(levels: LevelSet) -> list[Camera]:
    """As many frames of a round of 48 seconds, 30 a second, as a fade needs and one more."""
    return orbit(circle_of_levels(levels), lens_of(FLIGHT_WIDTH), 48 * 30)[: FADE_FRAMES + 1]
