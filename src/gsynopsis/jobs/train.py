"""Scene and recipe to a run: train, measure, pack, each step resumable, nothing half written."""

import signal
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from gsynopsis.config import (
    Config,
    PresetName,
    Recipe,
    preset_value,
    replaced,
    resolve_settings,
    total_steps,
)
from gsynopsis.container.info import LevelInfo, describe
from gsynopsis.errors import GsynopsisError, InputError, SettingError
from gsynopsis.evaluation.protocols import Options
from gsynopsis.evaluation.report import Report
from gsynopsis.evaluation.report_files import write_report
from gsynopsis.jobs.decide_exposure import with_exposure
from gsynopsis.jobs.evaluate import Measures
from gsynopsis.jobs.write_file import (
    FilePacker,
    Packing,
    provenance_of,
    write_draft,
    write_file,
)
from gsynopsis.model.build import photo_cell
from gsynopsis.monitor.display import Display
from gsynopsis.monitor.eta import Estimate, phase_costs, steps_text
from gsynopsis.monitor.notebook import NotebookBar
from gsynopsis.monitor.snapshots import previewing
from gsynopsis.monitor.tensorboard import Board, load_writer
from gsynopsis.render.choose import RendererName, make_renderer
from gsynopsis.resources.photo_store import photos_kept
from gsynopsis.resources.report import bounded_setup, plan_lines, plan_of
from gsynopsis.runs.folder import (
    RESULT_FILE,
    RUN_FILE,
    Run,
    make_folder,
    read_run,
    recorded_config,
    write_record,
)
from gsynopsis.runs.lock import claimed
from gsynopsis.scene.masks import check_masks
from gsynopsis.scene.photos import check_photos
from gsynopsis.scene.scene import Scene, load_scene
from gsynopsis.training.checkpoint import begin_from, load_state
from gsynopsis.training.distributed.process_group import World, joined
from gsynopsis.training.extend import go_on_longer
from gsynopsis.training.loop import CHECKPOINT, FULL, open_state, phases_of, run_training
from gsynopsis.training.observer import Observer, Silent
from gsynopsis.training.state import Cursor, Setup, TrainState

MIB = 2**20
SIZE_TOLERANCE = 0.02
"""Share by which a level may differ from its ordered size without a word."""
CHECKPOINT_SECONDS = 120.0
"""Between checkpoints: at most this is lost on a power cut (ours)."""


@dataclass(frozen=True)
class Conduct:
    """How a training is conducted; nothing here changes what it produces.

    Attributes:
        renderer: Rasteriser; `auto` takes CUDA if it is there, else the CPU one.
        evaluate: Write the report of an evaluation beside the file.
        max_memory: GiB that training may take, of the GPU's memory if one trains, per process of
            torchrun: growth stops in time, and what cannot start is refused. None: no limit.
        checkpoint_seconds: Wall time between checkpoints.
        photo_pixels: Pixels to render at the photos' own size in the evaluation.
        exposure: Evaluate also after the photos' exposure was taken out, if it was not learnt.
        tensorboard: Write loss, held-out PSNR and pictures to RUN/tensorboard meanwhile.
        cache: Folder for decoded photos, which stay there for other trainings. None: in memory, or
            in RUN/photos where they are too many, until the training is done.
    """

    renderer: RendererName = "auto"
    evaluate: bool = True
    max_memory: float | None = None
    checkpoint_seconds: float = CHECKPOINT_SECONDS
    photo_pixels: int = Measures.photo_pixels
    exposure: bool = False
    tensorboard: bool = False
    cache: Path | None = None


def resolve(
    preset: str = "fast", scene: Scene | int | None = None, asked: Mapping[str, Any] | None = None
) -> Recipe:
    """The settings of a training: a preset, what was asked for, what follows from the scene.

    Args:
        preset: `fast` (CPU, minutes), `ours` (best quality), both with our own anchor model, or
            `paper` (the paper's values).
        scene: The scene, or how many training photos there are; None: nothing follows from it.
        asked: Values by dotted name, as `{"train.steps": 300}`; they always win.

    Raises:
        SettingError: there is no such preset or setting, or a value cannot be.

    Examples:
        >>> scene = gs.load_scene("scene")
        >>> recipe = gs.resolve("fast", scene, {"train.steps": 30, "levels.steps": 50})
        >>> recipe.config.train.steps, recipe.config.levels.keep
        (30, (0.7, 0.5, 0.4))
    """
    asked = dict(asked or {})
    if not isinstance(scene, Scene):
        return resolve_settings(preset, scene, asked)
    split = asked.get("split", scene.split)
    if split != preset_value("split", preset):
        asked["split"] = split
    if split != scene.split:
        advice = f"load it so: load_scene(path, split={split!r})"
        found = f"a scene split by {scene.split}"
        raise SettingError("split", found=found, expected=split, advice=advice)
    scale = asked.get("scale", preset_value("scale", preset))
    cell = photo_cell(scene, scale) if isinstance(scale, int | float) and scale >= 1 else None
    points = len(scene.points)
    recipe = resolve_settings(preset, len(scene.train), asked, cell, points)
    settings = recipe.config.train
    if settings.exposure == "on" and settings.batch > 1:
        expected = "--batch 1: exposure is solved from one view per step"
        raise SettingError("--batch", found=settings.batch, expected=expected)
    return recipe


def train(
    scene: Scene | Path | str,
    recipe: Recipe | str = "fast",
    out: Path | str = "runs/run",
    observer: Observer | None = None,
    *,
    conduct: Conduct | None = None,
) -> Run:
    """Train a scene into a run's folder, or go on with what is there, and pack the result.

    Args:
        scene: A scene, or its folder.
        recipe: From `resolve`, or the name of a preset.
        out: Folder of the run, made if it is missing; no other process may train in it.
        observer: Told of everything; None shows a progress bar.
        conduct: Renderer, evaluation, limits.

    Returns:
        The run; `run.open()` is its file.

    Raises:
        KeyboardInterrupt: the user stopped it; everything so far is saved.
        SceneError: the scene cannot be used.
        SettingError: the settings cannot be used, or another process trains in the folder.
        SpaceError: not enough disk or memory.

    Examples:
        >>> scene = gs.load_scene("scene")
        >>> recipe = gs.resolve("fast", scene, {"train.steps": 30, "levels.steps": 50})
        >>> run = gs.train(scene, recipe, "runs/room")
        >>> run.file.name, run.steps
        ('scene.gsyn', 80)
    """
    scene = scene if isinstance(scene, Scene) else load_scene(Path(scene))
    recipe = resolve(recipe, scene) if isinstance(recipe, str) else recipe
    conduct = conduct or Conduct()
    with joined() as world:
        setup = make_setup(scene, recipe.config, conduct, world)
        with ExitStack() as shown:
            if observer is None:
                observer = shown.enter_context(Display(quiet=not world.leads))
            for line in before_training(setup, recipe):
                observer.on_message(line)
            train_into(setup, recipe, Path(out), observer, conduct=conduct)
    return read_run(Path(out))


def unfold(
    run: Run | Path | str,
    out: Path | str,
    asked: Mapping[str, Any] | None = None,
    observer: Observer | None = None,
    *,
    conduct: Conduct | None = None,
) -> Run:
    """Make levels another way from the full model of a run, without training that again.

    Args:
        run: A run, finished or not, whose full model is trained.
        out: Folder of the new run.
        asked: Settings of levels, by dotted name, as `{"levels.mode": "sequential"}`.
        observer: Told of everything; None shows a progress bar.
        conduct: Renderer, evaluation, limits.

    Raises:
        SettingError: the run has no full model, or a setting of it was to be changed.

    Examples:
        >>> asked = {"levels.mode": "sequential", "levels.steps": 10}
        >>> run = gs.unfold("runs/room", "runs/sequential", asked)
        >>> run.steps
        60
    """
    with ExitStack() as shown:
        told = shown.enter_context(Display()) if observer is None else observer
        unfold_into(run, out, asked or {}, told, conduct=conduct or Conduct())
    return read_run(Path(out))


def unfold_into(
    run: Run | Path | str,
    out: Path | str,
    asked: Mapping[str, Any],
    observer: Observer,
    *,
    conduct: Conduct,
) -> Report | None:
    """As `unfold`; the report, if one was ordered, in the first process."""
    run, out = run if isinstance(run, Run) else read_run(Path(run)), Path(out)
    start = run.folder / FULL
    if not start.is_file():
        advice = "train the run first"
        raise SettingError(start, found="nothing", expected="a full model", advice=advice)
    recipe = unfolded(recorded_config(run.folder), asked, run.preset or "fast")
    setup_of = _setup_of(run)

    with joined() as world:
        setup = setup_of(recipe.config, conduct, world)

        def begin() -> str:
            if not (out / CHECKPOINT).exists():
                begin_from(setup, start, out / FULL, out / CHECKPOINT)
            return ""

        told = observer if world.leads else Silent()
        return train_into(setup, recipe, out, told, conduct=conduct, begin=begin)


def unfolded(config: Config, asked: Mapping[str, Any], preset: PresetName) -> Recipe:
    """The settings of a run with other levels.

    Raises:
        SettingError: a setting of the full model was to be changed, or a value cannot be.
    """
    asked = dict(asked)
    mode = asked.get("levels.mode", config.levels.mode)
    if mode != config.levels.mode:
        # The other way of making levels has settings of its own: the preset's, same shares kept.
        other = resolve_settings(preset, None, {"levels.mode": mode}).config.levels
        config = replace(config, levels=replace(other, keep=config.levels.keep))
    ordered = asked.get("levels.level_mib")
    if ordered and "levels.keep" not in asked:
        asked["levels.keep"] = resolve_settings(preset, None, asked).config.levels.keep
    changed = replaced(config, asked)
    if (changed.model, changed.train) != (config.model, config.train):
        advice = "train another run"
        raise SettingError("unfold", found="a change of the full model", advice=advice)
    return Recipe(preset, changed, frozenset(asked))


def pack(
    run: Run | Path | str,
    out: Path | str | None = None,
    packing: Packing | None = None,
    observer: Observer | None = None,
) -> Path:
    """Write a finished run's levels as one file again, in either coding.

    Args:
        run: A finished run.
        out: The file; None replaces the run's own.
        packing: Coding, size of blocks, licence.
        observer: Told of progress; None shows a bar.

    Raises:
        InputError: the run has no checkpoint, or is not finished.
        SpaceError: the disk has no room.

    Examples:
        >>> path = gs.pack("runs/room", "again.gsyn")
        >>> len(gs.check(path))
        4
    """
    run = run if isinstance(run, Run) else read_run(Path(run))
    checkpoint = run.folder / CHECKPOINT
    if run.scene is None or not checkpoint.is_file():
        raise InputError(checkpoint, found="nothing", expected="the checkpoint of a run")
    config = recorded_config(run.folder)
    setup = _setup_of(run)(config, Conduct(), World())
    state = load_state(setup, checkpoint)
    if state.cursor.phase < len(phases_of(config)):
        advice = "repeat its train command first"
        raise InputError(checkpoint, found="an unfinished run", advice=advice)
    path = run.file if out is None else Path(out)
    with ExitStack() as shown:
        told = shown.enter_context(Display()) if observer is None else observer
        write_file(state, run.preset or "fast", path, packing, tick=told.on_pass)
    return path


def make_setup(scene: Scene, config: Config, conduct: Conduct, world: World | None = None) -> Setup:
    """What a training is given, under the limit of memory there may be.

    Raises:
        SettingError: the batch is larger than the photos, or not shared evenly by the processes.
        SpaceError: not even the anchors of the start fit the memory.
    """
    world, batch, photos = world or World(), config.train.batch, len(scene.train)
    if batch % world.size:
        expected = f"a multiple of the {world.size} processes"
        raise SettingError("--batch", found=batch, expected=expected)
    if batch > photos:
        expected = f"at most the {photos} photos to train on"
        raise SettingError("--batch", found=batch, expected=expected)
    setup = Setup(scene, config, make_renderer(conduct.renderer), FilePacker(), world)
    return bounded_setup(setup, conduct.max_memory)


def before_training(setup: Setup, recipe: Recipe) -> list[str]:
    """What to know before a training starts: notes, settings that follow the scene, the plan.

    Args:
        setup: Of the training.
        recipe: Likewise.
    """
    lines = [*setup.scene.notes, setup.scene.account.text()]
    lines += [f"settings: {line}" for line in recipe.lines() if "asked for" not in line]
    plan, wanted = plan_of(setup), recipe.config.train.growth.max_anchors
    lines += plan_lines(plan, steps_text(setup.config))
    if setup.config.train.growth.max_anchors < wanted:
        lines.append(f"plan: --max-memory stops growth at {plan.max_anchors:,} anchors")
    return lines


def train_into(
    setup: Setup,
    recipe: Recipe,
    out: Path,
    observer: Observer,
    *,
    conduct: Conduct,
    begin: Callable[[], str] | None = None,
    watch: Callable[[TrainState, Observer], Observer] | None = None,
) -> Report | None:
    """Train (or go on training) in a folder, measure, pack, and write the report.

    Args:
        setup: Of the training.
        recipe: Where the settings come from, for the record.
        out: Folder of the run, made if it is missing; no other process may train in it.
        observer: Told of everything.
        conduct: Evaluation and checkpoints.
        begin: Puts into the folder what the training starts from; returns a line or "".
        watch: Given the state before its first step; returns who is told of steps.

    Returns:
        The report if one was ordered, in the first process.

    Raises:
        KeyboardInterrupt: the user stopped it; everything so far is saved.
        SettingError: another process trains in the folder.
        SceneError: a photo cannot be decoded.
        MissingExtraError: TensorBoard is ordered and not installed.
    """
    world, scene, result = setup.world, setup.scene, out / RESULT_FILE
    if conduct.tensorboard:
        load_writer()  # refuses before anything is written

    def record(cursor: Cursor | None = None) -> None:
        write_record(
            out,
            scene,
            setup.config,
            recipe,
            seconds=cursor.seconds if cursor else 0.0,
            phase_seconds=cursor.phase_seconds if cursor else None,
        )

    with ExitStack() as held:

        def prepare() -> None:
            make_folder(out)
            held.enter_context(claimed(out))
            _open_photos(scene, observer)

        def start() -> None:
            line = begin() if begin else go_on_longer(out, scene.fingerprint(), setup.config)
            if line:
                observer.on_message(line)
            # The record of a run that may yet refuse to go on under these settings stays.
            if not ((out / CHECKPOINT).exists() and (out / RUN_FILE).exists()):
                record()

        with stop_on_interrupt(alone=world.size == 1) as stop:
            world.lead(prepare)
            kept = photos_kept(setup, out, conduct.cache, observer.on_message)
            forget_photos = held.enter_context(kept)
            setup, recipe = with_exposure(setup, recipe, out, observer, stop)
            world.lead(start)
            state = open_state(setup, out, observer)
            takers = [observer.take] if isinstance(observer, NotebookBar) else []
            if conduct.tensorboard and world.leads:
                takers.append(held.enter_context(closing(Board(out))).take)
            watched = previewing(state, watch(state, observer) if watch else observer, takers)
            told = Estimate(watched, phase_costs(setup.config))
            complete = run_training(state, out, told, stop, conduct.checkpoint_seconds)
        world.lead(lambda: record(state.cursor))
        if not complete:
            raise KeyboardInterrupt
        reports: list[Report | None] = []
        world.lead(
            lambda: reports.append(_pack_result(state, recipe.preset, result, observer, conduct))
        )
        world.lead(forget_photos)
    return reports[0] if reports else None


def _pack_result(
    state: TrainState, preset: PresetName, path: Path, observer: Observer, conduct: Conduct
) -> Report | None:
    config, scene = state.setup.config, state.setup.scene
    options = None
    if conduct.evaluate:
        provenance = provenance_of(state, preset, total_steps(config))
        options = Options(
            frames=Measures.frames,
            provenance=provenance,
            photo_pixels=conduct.photo_pixels,
            inside=scene.inside if scene.masked else None,
            exposure=conduct.exposure or state.exposures is not None,
        )
    try:
        report = write_file(state, preset, path, options=options, tick=observer.on_pass)
    except GsynopsisError as error:
        # What was trained is not lost for what cannot be measured; a full disk refuses it again.
        write_draft(state, preset, path)
        observer.on_message(f"the file carries no figures, it could not be measured: {error}")
        report = None
    for note in size_notes(describe(path).levels, config.levels.level_bytes):
        observer.on_message(note)
    observer.on_message(f"wrote {path} ({path.stat().st_size / MIB:.2f} MiB)")
    if report is not None:
        for note in write_report(report, path.parent).notes:
            observer.on_message(note)
    return report


def _setup_of(run: Run) -> Callable[[Config, Conduct, World], Setup]:
    if run.scene is None:
        raise SettingError(run.folder, "scene", found="nothing", expected="a scene's path")
    folder = run.scene

    def make(config: Config, conduct: Conduct, world: World) -> Setup:
        return make_setup(load_scene(folder, config.split, run.reading), config, conduct, world)

    return make


def _open_photos(scene: Scene, observer: Observer) -> None:
    """Decode every photo once, held-out ones too: better a damaged one ends this than a training.

    Raises:
        SceneError: one cannot be decoded.
    """
    paths = [scene.views[view].path for view in sorted({*scene.train, *scene.test})]
    for done, _ in enumerate(check_photos(paths), start=1):
        observer.on_pass("opening photos", done, len(paths))
    if scene.masked:
        for done, _ in enumerate(check_masks(scene), start=1):
            observer.on_pass("opening masks", done, len(paths))


def size_notes(levels: Sequence[LevelInfo], ordered: Sequence[int]) -> list[str]:
    """A sentence on levels whose size is not the ordered one, and one on levels that add nothing.

    Args:
        levels: Of the packed file.
        ordered: Bytes of the file up to each level's end that were asked for; empty if none were.
    """
    small, large = list[str](), list[str]()
    for level, size in zip(levels, ordered, strict=False):
        text = f"L{level.level} {level.bytes / MIB:.3g} MiB instead of {size / MIB:.3g}"
        if level.bytes < (1 - SIZE_TOLERANCE) * size:
            small.append(text)
        elif level.bytes > (1 + SIZE_TOLERANCE) * size:
            large.append(text)
    notes = [f"levels: smaller than ordered, there is no more: {', '.join(small)}"] * bool(small)
    notes += [f"levels: larger than ordered, none can be less: {', '.join(large)}"] * bool(large)
    pairs = pairwise(levels)
    same = [f"L{fine.level}" for coarse, fine in pairs if fine.slots == coarse.slots]
    return notes + [f"levels: no Gaussians beyond the level below: {', '.join(same)}"] * bool(same)


@contextmanager
def stop_on_interrupt(*, alone: bool = True) -> Generator[Callable[[], bool]]:
    """Within it Ctrl-C or SIGTERM asks to stop; the same one again interrupts at once.

    Not so under torchrun (`alone` false), which may repeat a signal and kills whoever is too slow.
    Outside of the main thread, where Python has no signals, nothing is caught.
    """
    asked = set[int]()

    def ask(number: int, frame: object) -> None:
        if number in asked and alone:
            raise KeyboardInterrupt
        asked.add(number)

    before: dict[signal.Signals, Any] = {}
    try:
        for kind in (signal.SIGINT, signal.SIGTERM):
            before[kind] = signal.signal(kind, ask)
    except ValueError:
        pass
    try:
        yield lambda: bool(asked)
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)
