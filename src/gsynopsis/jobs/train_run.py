"""One training in a folder: prepare, phases, file, report; each step resumable."""

from collections.abc import Sequence
from contextlib import ExitStack, closing
from itertools import pairwise
from pathlib import Path

from gsynopsis.config import Config, PresetName, Recipe, total_steps
from gsynopsis.container.info import LevelInfo, describe
from gsynopsis.errors import GsynopsisError, SettingError
from gsynopsis.evaluation.protocols import Options
from gsynopsis.evaluation.report import Report
from gsynopsis.evaluation.report_files import write_report
from gsynopsis.interrupt import stop_on_interrupt
from gsynopsis.jobs.decide_exposure import with_exposure
from gsynopsis.jobs.evaluate import Measures
from gsynopsis.jobs.options import RunOptions
from gsynopsis.jobs.start import Start
from gsynopsis.jobs.write_file import FilePacker, provenance_of, write_draft, write_file
from gsynopsis.monitor.eta import TimeLeft, phase_costs, steps_text
from gsynopsis.monitor.listeners import Listeners
from gsynopsis.monitor.live_page import LivePage, live_page
from gsynopsis.monitor.snapshots import SnapshotListener, snapshots_of
from gsynopsis.monitor.tensorboard import TensorBoardWriter, load_writer
from gsynopsis.render.choose import TakenDevice, take_device
from gsynopsis.resources.photo_store import photo_store
from gsynopsis.resources.report import bounded, plan_lines, plan_of
from gsynopsis.runs.folder import (
    RESULT_FILE,
    RUN_FILE,
    make_folder,
    write_record,
)
from gsynopsis.runs.lock import run_lock
from gsynopsis.scene.masks import check_masks
from gsynopsis.scene.photos import check_photos
from gsynopsis.scene.scene import Scene
from gsynopsis.training.context import TrainContext
from gsynopsis.training.distributed.process_group import ProcessGroup
from gsynopsis.training.loop import CHECKPOINT, open_state, run_training
from gsynopsis.training.observer import Observer
from gsynopsis.training.state import TrainState
from gsynopsis.training.webgpu.choose import left_to_host

MIB = 2**20
SIZE_TOLERANCE = 0.02
"""Share by which a level may differ from its ordered size without a note."""


def make_context(
    scene: Scene,
    config: Config,
    options: RunOptions,
    group: ProcessGroup | None = None,
    taken: TakenDevice | None = None,
) -> TrainContext:
    """Scene, settings and machinery of a training, its growth bounded by `max_memory`.

    Args:
        scene: Photos, cameras and points.
        config: Settings.
        options: Device and limits.
        group: Processes that train together; None: this one alone.
        taken: The device, if it was taken (and tested) before; None: that of the options.

    Raises:
        SettingError: the batch is larger than the photos, or not shared evenly by the processes.
        SpaceError: not even the anchors of the start fit the memory.
    """
    group, batch, photos = group or ProcessGroup(), config.train.batch, len(scene.train)
    if batch % group.size:
        expected = f"a multiple of the {group.size} processes"
        raise SettingError("--batch", found=batch, expected=expected)
    if batch > photos:
        expected = f"at most the {photos} photos to train on"
        raise SettingError("--batch", found=batch, expected=expected)
    taken = taken or take_device(options.device)
    context = TrainContext(scene, config, taken.renderer, FilePacker(), group, device=taken.why)
    return bounded(context, options.max_memory)


def before_training(context: TrainContext, recipe: Recipe) -> list[str]:
    """Notes, settings that follow the scene, and the plan: what to know before a training."""
    lines = [*context.scene.notes, context.scene.account.text()]
    lines += [f"settings: {line}" for line in recipe.lines() if "asked for" not in line]
    plan, wanted = plan_of(context), recipe.config.train.growth.max_anchors
    lines += plan_lines(plan, steps_text(context.config))
    lines += device_lines(context)
    if context.config.train.growth.max_anchors < wanted:
        lines.append(f"plan: --max-memory stops growth at {plan.max_anchors:,} anchors")
    return lines


def device_lines(context: TrainContext) -> list[str]:
    """Lines on the device that trains, why, and what a WebGPU device leaves to the CPU."""
    if not context.device:
        return []
    lines = [f"device: {context.device}"]
    if context.renderer.name == "webgpu" and (left := left_to_host(context)):
        lines.append(f"device: it makes images and their gradients alone, because of {left}")
    return lines


def tell_plan(observer: Observer, context: TrainContext, recipe: Recipe) -> None:
    """Tell an observer what to know before a training, a message a line."""
    for line in before_training(context, recipe):
        observer.on_message(line)


def train_run(
    context: TrainContext,
    recipe: Recipe,
    out: Path,
    start: Start,
    options: RunOptions,
    observer: Observer,
) -> Report | None:
    """Train (or go on training) in a folder, pack, evaluate, and write the report.

    Args:
        context: Scene, settings and machinery.
        recipe: Where the settings come from, for the record.
        out: Folder of the run, made if it is missing; no other process may train in it.
        start: What the training begins from.
        options: Evaluation, checkpoints, listeners.
        observer: Hears of everything.

    Returns:
        The report if one was ordered, in the first process.

    Raises:
        KeyboardInterrupt: the user stopped it; everything so far is saved.
        SettingError: another process trains in the folder.
        SceneError: a photo cannot be decoded.
        MissingExtraError: TensorBoard is ordered and not installed.
    """
    group, scene = context.group, context.scene
    if options.tensorboard:
        load_writer()  # refuses before anything is written
    with ExitStack() as held:
        with stop_on_interrupt(alone=group.size == 1) as stop:
            group.on_main(lambda: _enter_folder(scene, out, held, observer))
            photos = photo_store(context, out, options.cache, observer.on_message)
            remove_photos = held.enter_context(photos)
            context, recipe = with_exposure(context, recipe, out, observer, stop)
            group.on_main(lambda: _prepare(context, recipe, out, start, observer))
            state = open_state(context, out, observer)
            listeners, page = _listeners(state, recipe, out, options, observer, held)
            complete = run_training(state, out, listeners, stop, options.checkpoint_seconds)
        group.on_main(lambda: _record(context, recipe, out, state))
        if not complete:
            raise KeyboardInterrupt
        report = group.on_main(lambda: pack_result(state, recipe.preset, out, observer, options))
        if page is not None:
            page.finish()
        group.on_main(remove_photos)
    return report


def pack_result(
    state: TrainState, preset: PresetName, out: Path, observer: Observer, options: RunOptions
) -> Report | None:
    """Write RUN/scene.gsyn and, if it is ordered, its report; says where they are."""
    config, path = state.context.config, out / RESULT_FILE
    measures = None
    if options.evaluate:
        measures = Options(
            frames=Measures.frames,
            provenance=provenance_of(state, preset, total_steps(config)),
            photo_pixels=options.photo_pixels,
            exposure=options.exposure or state.exposures is not None,
        )
    try:
        report = write_file(state, preset, path, options=measures, tick=observer.on_pass)
    except GsynopsisError as error:
        # What was trained is not lost for what cannot be measured; a full disk refuses it again.
        write_draft(state, preset, path)
        observer.on_message(f"the file carries no figures, it could not be measured: {error}")
        report = None
    for note in size_notes(describe(path).levels, config.levels.level_bytes):
        observer.on_message(note)
    observer.on_message(f"wrote {path} ({path.stat().st_size / MIB:.2f} MiB)")
    if report is not None:
        for note in write_report(report, out).notes:
            observer.on_message(note)
    return report


def size_notes(levels: Sequence[LevelInfo], ordered: Sequence[int]) -> list[str]:
    """Lines on levels that miss their ordered size, and on levels that add nothing.

    Args:
        levels: Levels of the packed file.
        ordered: Bytes of the file up to each level's end that were asked for; empty if none were.
    """
    small, large = list[str](), list[str]()
    for level, size in zip(levels, ordered, strict=False):
        text = f"L{level.level} {level.bytes / MIB:.3g} MiB instead of {size / MIB:.3g}"
        if level.bytes < (1 - SIZE_TOLERANCE) * size:
            small.append(text)
        elif level.bytes > (1 + SIZE_TOLERANCE) * size:
            large.append(text)
    notes = [f"levels: sizes below target, all anchors used: {', '.join(small)}"] * bool(small)
    notes += [f"levels: sizes above target, minimum reached: {', '.join(large)}"] * bool(large)
    pairs = pairwise(levels)
    same = [f"L{fine.level}" for coarse, fine in pairs if fine.slots == coarse.slots]
    return notes + [f"levels: no Gaussians beyond the level below: {', '.join(same)}"] * bool(same)


def _enter_folder(scene: Scene, out: Path, held: ExitStack, observer: Observer) -> None:
    """Make and lock the folder, then decode every photo and mask once.

    Held-out ones too: better that a damaged one ends this than a training.

    Raises:
        SceneError: one cannot be decoded.
        SettingError: another process trains in the folder.
    """
    make_folder(out)
    held.enter_context(run_lock(out))
    views = [scene.views[view] for view in sorted({*scene.train, *scene.test})]
    for done, _ in enumerate(check_photos([view.path for view in views]), start=1):
        observer.on_pass("opening photos", done, len(views))
    if scene.masked:
        for done, _ in enumerate(check_masks(views), start=1):
            observer.on_pass("opening masks", done, len(views))


def _prepare(
    context: TrainContext, recipe: Recipe, out: Path, start: Start, observer: Observer
) -> None:
    if line := start.prepare(context, out):
        observer.on_message(line)
    # The record of a run that may yet refuse to go on under these settings stays.
    if not ((out / CHECKPOINT).exists() and (out / RUN_FILE).exists()):
        _record(context, recipe, out)


def _record(
    context: TrainContext, recipe: Recipe, out: Path, state: TrainState | None = None
) -> None:
    done = state.progress if state else None
    write_record(
        out,
        context.scene,
        context.config,
        recipe,
        seconds=done.seconds if done else 0.0,
        phase_seconds=done.phase_seconds if done else None,
    )


def _listeners(
    state: TrainState,
    recipe: Recipe,
    out: Path,
    options: RunOptions,
    observer: Observer,
    held: ExitStack,
) -> tuple[Listeners, LivePage | None]:
    """Everybody who hears of steps, and the live page among them."""
    observers, page = [observer], None
    if state.context.group.is_main:
        if options.viewer_port is not None:
            pack = lambda path: write_draft(state, recipe.preset, path)  # noqa: E731
            page = held.enter_context(live_page(state, pack, options.viewer_port, observer))
            observers.append(page)
        writers: list[SnapshotListener] = []
        if isinstance(observer, SnapshotListener):
            writers.append(observer)
        if options.tensorboard:
            writers.append(held.enter_context(closing(TensorBoardWriter(out))))
        if writers:
            observers.append(snapshots_of(state, writers))
    scene, config = state.context.scene, state.context.config
    camera = scene.camera(scene.train[0], config.scale)
    costs = phase_costs(config, camera.width * camera.height)
    return Listeners(observers, TimeLeft(costs)), page
