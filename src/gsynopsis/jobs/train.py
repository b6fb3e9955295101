"""A scene to a run: poses, settings, plan, phases, file, report; each step resumable."""

import hashlib
import os
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from gsynopsis.capture.triangulate import triangulate
from gsynopsis.capture.video import is_video
from gsynopsis.config import PresetName, Recipe, Split, resolve_settings
from gsynopsis.errors import MissingExtraError, NoPosesError, SettingError
from gsynopsis.jobs.estimate_poses import POSED, pose_for
from gsynopsis.jobs.evaluate import Measures
from gsynopsis.jobs.options import RunOptions
from gsynopsis.jobs.resolve import resolve
from gsynopsis.jobs.start import Fresh
from gsynopsis.jobs.train_blocks import division_of, train_in_blocks
from gsynopsis.jobs.train_run import make_context, tell_plan, train_run
from gsynopsis.monitor.display import Display
from gsynopsis.runs.folder import Run, make_folder, read_run
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.masks import MaskUse, no_masks
from gsynopsis.scene.scene import Scene, SceneOptions
from gsynopsis.training.context import TrainContext
from gsynopsis.training.distributed.process_group import ProcessGroup, init_process_group
from gsynopsis.training.observer import Observer

WIDTH_MOST = 65_536
OnPlan = Callable[[TrainContext, Recipe], None]
"""Hears what a training is going to take, before it starts."""


def train(  # noqa: PLR0913 -- flat keywords, as people call it
    scene: Scene | Path | str,
    preset: PresetName | Recipe = "standard",
    out: Path | str = "runs/run",
    observer: Observer | None = None,
    *,
    steps: int | None = None,
    settings: Mapping[str, Any] | None = None,
    scale: float | None = None,
    max_width: int = 0,
    split: Split | None = None,
    images: str | None = None,
    masks: MaskUse | None = None,
    blocks: int = 0,
    jobs: int = 1,
    ray: str | None = None,
    device: str = "auto",
    evaluate: bool = True,
    max_memory: float | None = None,
    checkpoint_seconds: float = RunOptions.checkpoint_seconds,
    photo_pixels: int = Measures.photo_pixels,
    exposure: bool = False,
    tensorboard: bool = False,
    viewer_port: int | None = None,
    cache: Path | None = None,
    quiet: bool = False,
    on_plan: OnPlan | None = None,
) -> Run:
    """Train a scene into a run's folder, or go on with what is there, and pack the result.

    Args:
        scene: A scene, or its folder; of photos alone or a video poses are estimated first, into
            OUT/scene.
        preset: Name of a preset, or a recipe from `resolve`.
        out: Folder of the run, made if it is missing; no other process may train in it.
        observer: Hears of everything; None shows a progress bar.
        steps: Steps of the full training; those of the levels scale along.
        settings: Other settings by dotted name, as `{"levels.keep": (0.7, 0.5, 0.4)}`.
        scale: Divisor of the photos' width and height: the training resolution. None: 1.
        max_width: Pixels across to which wider photos are divided; 0: any.
        split: Rule that chooses the held-out views. None: `every8`.
        images: Folder of photos in the scene's. None: `images`.
        masks: Use of masks/NAME.png, or of alpha channels. None: `loss`, if there are any.
        blocks: Blocks of space, each trained on its own after the whole; 0: one training.
        jobs: Blocks at once, each a process.
        ray: Address of a Ray cluster that trains the blocks instead, or `local`.
        device: What trains; see `RunOptions` for this and what follows.
        evaluate: Write the report of an evaluation beside the file.
        max_memory: Limit of memory, GiB.
        checkpoint_seconds: Training time between checkpoints.
        photo_pixels: Pixels to render at the photos' own size in the evaluation.
        exposure: Evaluate also after the photos' exposure was taken out.
        tensorboard: Write to RUN/tensorboard meanwhile.
        viewer_port: Port of a page that shows the training; None: no page.
        cache: Folder for decoded photos.
        quiet: Show no progress bar.
        on_plan: Hears the plan; None: its lines are messages.

    Returns:
        The run; `run.open()` is its file, `run.report` its evaluation.

    Raises:
        KeyboardInterrupt: the user stopped it; everything so far is saved.
        SceneError: the scene cannot be used.
        SettingError: the settings cannot be used, or another process trains in the folder.
        SpaceError: not enough disk or memory.

    Examples:
        >>> run = gs.train("scene", "draft", "runs/room", steps=30, settings={"levels.steps": 50})
        >>> run.file.name, run.steps
        ('scene.gsyn', 80)
    """
    out = Path(out)
    asked = _asked(settings, steps=steps, scale=scale, split=split)
    if isinstance(preset, str):
        resolve_settings(preset, None, asked)  # refuses before anything is read
    elif asked or max_width:
        raise SettingError("preset", found="a recipe and settings", expected="one of them")
    options = RunOptions(
        device=device,
        evaluate=evaluate,
        max_memory=max_memory,
        checkpoint_seconds=checkpoint_seconds,
        photo_pixels=photo_pixels,
        exposure=exposure,
        tensorboard=tensorboard,
        viewer_port=viewer_port,
        cache=cache,
    )
    _check_width(max_width)
    division = division_of(blocks, jobs, ray, options)
    with init_process_group() as group, ExitStack() as shown:
        if observer is None:
            observer = shown.enter_context(Display(quiet=quiet or not group.is_main))

        if isinstance(scene, Scene):
            _check_loaded(scene, split, images, masks)
        else:
            reading = SceneOptions("" if images in (None, "images") else images, masks or "loss")
            scene = posed_scene(Path(scene), out, split or "every8", reading, group, observer)
            if masks == "loss" and not scene.masked:
                raise no_masks(scene.root, "loss")

        scene = with_found_points(scene, out, group, observer)

        recipe = preset
        if isinstance(recipe, str):
            asked |= _bounded_width(scene, asked, max_width)
            recipe = resolve(recipe, scene, asked)

        context = make_context(scene, recipe.config, options, group)
        hear_plan = on_plan or partial(tell_plan, observer)
        hear_plan(context, recipe)

        if division is not None:
            report = train_in_blocks(context, recipe, out, division, options, observer)
        else:
            report = train_run(context, recipe, out, Fresh(), options, observer)
    return replace(read_run(out), report=report)


def posed_scene(
    folder: Path,
    out: Path,
    split: Split,
    reading: SceneOptions,
    group: ProcessGroup,
    observer: Observer,
) -> Scene:
    """The scene of a folder; poses are estimated into OUT/scene where there are none."""
    if not is_video(folder):
        try:
            return load_scene(folder, split, reading)
        except NoPosesError:
            pass
    group.on_main(lambda: pose_for(folder, out, observer, alpha=reading.masks == "alpha"))
    return load_scene(out / POSED, split, reading)


def with_found_points(scene: Scene, out: Path, group: ProcessGroup, observer: Observer) -> Scene:
    """The scene with points that its photos show, if its files have none; they are kept in OUT."""
    if not scene.random_points:
        return scene
    group.on_main(lambda: make_folder(out))
    source = hashlib.sha256(f"{scene.fingerprint()} {scene.train}".encode()).hexdigest()
    path = out / f"points-{source[:12]}.ply"

    def find() -> None:
        if path.is_file():
            return
        try:
            count = triangulate(scene, path, observer.on_pass)
        except MissingExtraError as error:
            observer.on_message(f"points are not looked for in the photos: {error}")
            return
        if not path.is_file():
            observer.on_message(f"only {count} points were found in the photos: random ones it is")

    group.on_main(find)
    if not path.is_file():
        return scene
    beside = os.path.relpath(path.resolve(), scene.root.resolve())
    return load_scene(scene.root, scene.split, replace(scene.reading, points=beside))


def _asked(settings: Mapping[str, Any] | None, **named: object) -> dict[str, Any]:
    """Settings by dotted name; keywords win, None is not asked for."""
    names = {"steps": "train.steps"}
    given = {names.get(n, n): value for n, value in named.items() if value is not None}
    return {**(settings or {}), **given}


def _check_width(most: int) -> None:
    """Refuse a width that no photo has, before anything is read."""
    if not 0 <= most <= WIDTH_MOST:
        raise SettingError("--max-width", found=most, expected=f"0 to {WIDTH_MOST:,}")


def _bounded_width(scene: Scene, asked: Mapping[str, Any], most: int) -> dict[str, float]:
    """The scale that makes the widest photo at most `most` pixels wide, where that is bounded."""
    if not most:
        return {}
    widest = max(view.camera.width for view in scene.views)
    return {"scale": max(asked.get("scale", 1.0), widest / most)}


def _check_loaded(
    scene: Scene, split: Split | None, images: str | None, masks: MaskUse | None
) -> None:
    """Refuse options of reading for a scene that is read already."""
    if (split or scene.split) != scene.split or images or masks:
        raise SettingError("scene", found="a loaded one", expected="its folder, with options")
