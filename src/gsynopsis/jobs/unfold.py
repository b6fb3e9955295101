"""Levels of a finished splat without its photos, or other levels of a run's full model."""

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from gsynopsis.errors import SettingError
from gsynopsis.evaluation.report import Report
from gsynopsis.formats.axes import Up
from gsynopsis.jobs.options import RunOptions
from gsynopsis.jobs.resolve import unfolded
from gsynopsis.jobs.start import FromFullModel
from gsynopsis.jobs.train_run import make_context, train_run
from gsynopsis.jobs.unfold_splats import Teaching, unfold_splats
from gsynopsis.monitor.display import Display
from gsynopsis.runs.folder import RUN_FILE, Run, read_run, recorded_config, scene_of_run
from gsynopsis.training.distributed.process_group import init_process_group
from gsynopsis.training.loop import FULL
from gsynopsis.training.observer import Observer, Silent


def unfold(  # noqa: PLR0913 -- flat keywords, as people call it
    source: Run | Path | str,
    out: Path | str,
    settings: Mapping[str, Any] | None = None,
    observer: Observer | None = None,
    *,
    views: int = Teaching.views,
    width: int = Teaching.width,
    up: Up | None = None,
    cameras: Path | str | None = None,
    scene: Path | str | None = None,
    device: str = "auto",
    evaluate: bool = True,
    max_memory: float | None = None,
    checkpoint_seconds: float = RunOptions.checkpoint_seconds,
    photo_pixels: int = RunOptions.photo_pixels,
    cache: Path | None = None,
    quiet: bool = False,
) -> Run:
    """Train levels of finished splats, or make levels another way from a run's full model.

    Args:
        source: A PLY, compressed PLY, SPZ, SOG, GLB or .splat file, or a `lod-meta.json`, whose
            renders are trained on; or a run, finished or not, whose full model is trained.
        out: Folder of the new run; what is trained there already is not again.
        settings: Settings by dotted name; of a run those of levels, as
            `{"levels.mode": "sequential"}`.
        observer: Hears of everything; None shows a progress bar.
        views: Renders of splats to train on; of cameras that are given without `scene` all are
            taken.
        width: Width of these renders, pixels.
        up: Away from the ground in the axes of the splats; None: as the file says, else as found.
        cameras: A cameras.json of 3DGS, a COLMAP model or a transforms.json of the same world, to
            render splats from; None: those of `scene` or beside the source, else such as are found.
        scene: Folder of the photos that the splats were made of, in their world: the training ones
            teach beside renders, and the report is of held-out ones.
        device: What trains: `auto`, `cpu`, `cuda`, `webgpu` or `webgpu:NAME`; see `RunOptions`.
        evaluate: Write the report of an evaluation beside the file.
        max_memory: Limit of memory, GiB; see `RunOptions`.
        checkpoint_seconds: Training time between checkpoints.
        photo_pixels: Pixels to render at the photos' own size in the evaluation.
        cache: Folder for decoded renders.
        quiet: Show no progress bar.

    Returns:
        The run; `run.open()` is its file, `run.report` its evaluation.

    Raises:
        InputError: the source holds no Gaussians that can be used, no camera sees them, or photos
            are of something else.
        SceneError: the scene of photos cannot be read.
        SettingError: the run has no full model, a setting of it was to be changed, `out` is a run
            of something else, or what is for splats alone was asked of a run.
        SpaceError: not enough disk or memory.

    Examples:
        >>> settings = {"levels.mode": "sequential", "levels.steps": 10}
        >>> run = gs.unfold("runs/room", "runs/sequential", settings)
        >>> run.steps
        60
    """
    out, settings = Path(out), settings or {}
    options = RunOptions(
        device=device,
        evaluate=evaluate,
        max_memory=max_memory,
        checkpoint_seconds=checkpoint_seconds,
        photo_pixels=photo_pixels,
        cache=cache,
    )
    with ExitStack() as shown:
        if observer is None:
            observer = shown.enter_context(Display(quiet=quiet))
        if isinstance(source, Run) or is_run(Path(source)):
            for name, value in {"up": up, "cameras": cameras, "scene": scene}.items():
                if value is not None:
                    expected = "a file of splats: a run is trained on its own photos"
                    raise SettingError(f"--{name}", found=f"{source}, a run", expected=expected)
            report = unfold_run(source, out, settings, observer, options)
        else:
            known, photos = (None if path is None else Path(path) for path in (cameras, scene))
            teaching = Teaching(views, width, up, known, photos)
            report = unfold_splats(Path(source), out, settings, observer, options, teaching)
    return replace(read_run(out), report=report)


def unfold_run(
    run: Run | Path | str,
    out: Path,
    settings: Mapping[str, Any],
    observer: Observer,
    options: RunOptions,
) -> Report | None:
    """Make levels another way from the full model of a run, without training that again.

    Raises:
        SettingError: the run has no full model, or a setting of it was to be changed.
    """
    run = run if isinstance(run, Run) else read_run(Path(run))
    start = FromFullModel(run.folder / FULL)
    if not start.checkpoint.is_file():
        advice, expected = "train the run first", "a full model"
        raise SettingError(start.checkpoint, found="nothing", expected=expected, advice=advice)
    recipe = unfolded(recorded_config(run.folder), settings, run.preset or "standard")
    scene = scene_of_run(run, recipe.config.split)
    with init_process_group() as group:
        heard = observer if group.is_main else Silent()
        context = make_context(scene, recipe.config, options, group)
        return train_run(context, recipe, out, start, options, heard)


def is_run(path: Path) -> bool:
    """True for a run's folder, false for a file, or a folder, of splats."""
    return path.is_dir() and (path / RUN_FILE).exists()
