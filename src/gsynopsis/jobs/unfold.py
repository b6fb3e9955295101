"""Other levels from the full model of a run, without training that again."""

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from gsynopsis.config import Split
from gsynopsis.errors import SettingError
from gsynopsis.jobs.options import RunOptions
from gsynopsis.jobs.resolve import unfolded
from gsynopsis.jobs.start import FromFullModel
from gsynopsis.jobs.train_run import make_context, train_run
from gsynopsis.monitor.display import Display
from gsynopsis.render.choose import RendererName
from gsynopsis.runs.folder import Run, read_run, recorded_config
from gsynopsis.scene.scene import Scene, load_scene
from gsynopsis.training.distributed.process_group import init_process_group
from gsynopsis.training.loop import FULL
from gsynopsis.training.observer import Observer, Silent


def unfold(  # noqa: PLR0913 -- flat keywords, as people call it
    run: Run | Path | str,
    out: Path | str,
    settings: Mapping[str, Any] | None = None,
    observer: Observer | None = None,
    *,
    renderer: RendererName = "auto",
    evaluate: bool = True,
    photo_pixels: int = RunOptions.photo_pixels,
    quiet: bool = False,
) -> Run:
    """Make levels another way from the full model of a run, without training that again.

    Args:
        run: A run, finished or not, whose full model is trained.
        out: Folder of the new run.
        settings: Settings of levels by dotted name, as `{"levels.mode": "sequential"}`.
        observer: Hears of everything; None shows a progress bar.
        renderer: Rasterizer; `auto` takes CUDA if it is there, else the CPU one.
        evaluate: Write the report of an evaluation beside the file.
        photo_pixels: Pixels to render at the photos' own size in the evaluation.
        quiet: Show no progress bar.

    Raises:
        SettingError: the run has no full model, or a setting of it was to be changed.

    Examples:
        >>> settings = {"levels.mode": "sequential", "levels.steps": 10}
        >>> run = gs.unfold("runs/room", "runs/sequential", settings)
        >>> run.steps
        60
    """
    run, out = run if isinstance(run, Run) else read_run(Path(run)), Path(out)
    start = FromFullModel(run.folder / FULL)
    if not start.checkpoint.is_file():
        advice, expected = "train the run first", "a full model"
        raise SettingError(start.checkpoint, found="nothing", expected=expected, advice=advice)
    recipe = unfolded(recorded_config(run.folder), settings or {}, run.preset or "fast")
    options = RunOptions(renderer=renderer, evaluate=evaluate, photo_pixels=photo_pixels)
    scene = scene_of_run(run, recipe.config.split)
    with init_process_group() as group, ExitStack() as shown:
        if observer is None:
            observer = shown.enter_context(Display(quiet=quiet))
        if not group.is_main:
            observer = Silent()
        context = make_context(scene, recipe.config, options, group)
        report = train_run(context, recipe, out, start, options, observer)
    return replace(read_run(out), report=report)


def scene_of_run(run: Run, split: Split) -> Scene:
    """The scene that a run was trained on, read as it was read then.

    Raises:
        SceneError: it is not there any more, or cannot be used.
        SettingError: the run does not know it.
    """
    if run.scene is None:
        raise SettingError(run.folder, "scene", found="nothing", expected="a scene's path")
    return load_scene(run.scene, split, run.reading)
