"""What `train`, `unfold`, `pack` and `demo` share: run a trainer, write its folder."""

import json
import os
import signal
from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from gsynopsis import __version__
from gsynopsis.cli.claim import claimed
from gsynopsis.cli.opening import Backend
from gsynopsis.cli.orbit import FIRST, circle_of_cameras, circle_text, first_text, first_view
from gsynopsis.cli.orbit import META as ORBIT
from gsynopsis.cli.poster import poster_of
from gsynopsis.cli.ranges import check_config
from gsynopsis.cli.run_folder import RESULT_FILE, RUN_FILE, Run
from gsynopsis.cli.settings import config_from_dict
from gsynopsis.cli.suit import for_views
from gsynopsis.config import Config, level_scale, total_steps
from gsynopsis.errors import InputError, MissingExtraError, SettingError
from gsynopsis.pack.info import LevelInfo, describe
from gsynopsis.records import LevelSet, Sensitivity
from gsynopsis.scene.photos import check_photos
from gsynopsis.train.progress import Observer

if TYPE_CHECKING:
    from gsynopsis.render.base import Focals
    from gsynopsis.train.trainer import Trainer
    from gsynopsis.train.world import World

MIB = 2**20
SIZE_TOLERANCE = 0.02
"""Share by which a level may differ from its ordered size without a word."""


@contextmanager
def training_world(config: Config) -> Generator["World"]:
    """This process among those that torchrun started, or alone; for one `with` block.

    Raises:
        MissingExtraError: torch is not installed.
        SettingError: the processes cannot share a batch evenly.
    """
    try:
        from gsynopsis.train.world import joined
    except ModuleNotFoundError as error:
        raise MissingExtraError(error.name or "torch", "train") from error
    with joined() as world:
        batch = config.train.batch
        if batch % world.size:
            expected = f"a multiple of the {world.size} processes"
            raise SettingError("--batch", found=batch, expected=expected)
        yield world


def new_trainer(
    scene: Path, config: Config, renderer: Backend, world: "World | None" = None
) -> "Trainer":
    """Load the scene and make a trainer for it, by the settings for as many views.

    Raises:
        MissingExtraError: torch is not installed.
        SceneError: the scene cannot be used.
    """
    try:
        from gsynopsis.train.trainer import Trainer
    except ModuleNotFoundError as error:
        raise MissingExtraError(error.name or "torch", "train") from error
    from gsynopsis.render.choose import make_renderer
    from gsynopsis.scene.scene import load_scene
    from gsynopsis.train.world import World

    loaded, packer = load_scene(scene, config.split), FilePacker()
    batch, photos = config.train.batch, len(loaded.train)
    if batch > photos:
        expected = f"at most the {photos} photos to train on"
        raise SettingError("--batch", found=batch, expected=expected)
    config = for_views(config, len(loaded.train))
    return Trainer(loaded, config, make_renderer(renderer), packer, world or World())


class FilePacker:
    """What training asks of the file format, in the coding of the result."""

    def sizes(self, levels: LevelSet) -> tuple[int, ...]:
        """Bytes of the file up to the end of each level."""
        from gsynopsis.pack.writer import encode_with_account

        return encode_with_account(levels)[1].ends

    def rounded(self, levels: LevelSet, sensitivity: Sensitivity, loss: float) -> LevelSet:
        """These levels with values that a file holds exactly; pictures lose about `loss` dB."""
        from gsynopsis.pack.rounding import rounded

        return rounded(levels, sensitivity, loss)

    def settle(self, levels: LevelSet) -> LevelSet:
        """What a reader gets of these levels."""
        from gsynopsis.pack import decode, encode

        return decode(encode(levels), "the packed levels")


@contextmanager
def stop_on_interrupt(*, alone: bool = True) -> Generator[Callable[[], bool]]:
    """Within it the first Ctrl-C (or SIGTERM) asks to stop; a second one interrupts at once.

    Not so under torchrun (`alone` false), which may repeat a signal and kills whoever is too slow.
    """
    asked = False

    def ask(number: int, frame: object) -> None:
        nonlocal asked
        if asked and alone:
            raise KeyboardInterrupt
        asked = True

    kinds = (signal.SIGINT, signal.SIGTERM)
    before = {kind: signal.signal(kind, ask) for kind in kinds}
    try:
        yield lambda: asked
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)


def train_into(
    trainer: "Trainer",
    scene: Path,
    out: Path,
    observer: Observer,
    prepare: Callable[[], None] = lambda: None,
) -> Path:
    """Train (or go on training) in a folder and pack the result.

    Args:
        trainer: A fresh one.
        scene: Folder of its scene, for the record.
        out: Folder of the run, made if it is missing; no other process may train in it.
        observer: Told of everything.
        prepare: Puts into the folder what the training starts from.

    Returns:
        The packed file.

    Raises:
        KeyboardInterrupt: the user stopped it; everything so far is saved.
        SettingError: another process trains in the folder.
        SceneError: a photo cannot be decoded.
    """
    from gsynopsis.train.run import CHECKPOINT, run_training

    world, result = trainer.world, out / RESULT_FILE
    with ExitStack() as held:

        def begin() -> None:
            make_folder(out)
            held.enter_context(claimed(out))
            open_photos(trainer, observer)
            prepare()
            # The record of a run that may yet refuse to go on under these settings stays.
            if not ((out / CHECKPOINT).exists() and (out / RUN_FILE).exists()):
                write_run_record(trainer, scene, out)

        with stop_on_interrupt(alone=world.size == 1) as stop:
            world.lead(begin)
            complete = run_training(trainer, out, observer, stop)
        world.lead(lambda: write_run_record(trainer, scene, out))
        if not complete:
            raise KeyboardInterrupt
        world.lead(lambda: pack_into(trainer, result, "compact"))
        if world.leads:
            levels = describe(result).levels
            for note in size_notes(levels, trainer.config.levels.level_bytes):
                observer.on_message(note)
    return result


def open_photos(trainer: "Trainer", observer: Observer) -> None:
    """Decode every photo once, held-out ones too: better a damaged one ends this than a training.

    Raises:
        SceneError: one cannot be decoded.
    """
    scene = trainer.scene
    paths = [scene.views[view].path for view in sorted({*scene.train, *scene.test})]
    for done, _ in enumerate(check_photos(paths), start=1):
        observer.on_pass("opening photos", done, len(paths))


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


def pack_into(
    trainer: "Trainer",
    path: Path,
    coding: Literal["raw", "compact"],
    licence: str | None = None,
    block: int = 0,
) -> Path:
    """Write the trained levels as one file.

    Args:
        trainer: Holds them.
        path: The file.
        coding: See `write_gsyn`.
        licence: What others may do with the scene.
        block: Largest number of anchors of a spatial block, 0 for the usual one.
    """
    from gsynopsis.model.build import model_to_levels
    from gsynopsis.pack import write_gsyn
    from gsynopsis.pack.spatial import BLOCK_ANCHORS

    assert trainer.model is not None
    meta = notes_of(trainer)
    if licence is not None:
        meta["licence"] = licence
    write_gsyn(model_to_levels(trainer.model, meta), path, coding, block or BLOCK_ANCHORS)
    return path


def notes_of(trainer: "Trainer") -> dict[str, str]:
    """What a file says of the scene, of how it was trained, and of the views that it was shown."""
    from gsynopsis.model.focals import META as FOCALS
    from gsynopsis.model.focals import focals_text
    from gsynopsis.model.seen import META as SEEN
    from gsynopsis.model.seen import seen_by, seen_text
    from gsynopsis.pack.poster import META as POSTER

    assert trainer.model is not None
    cameras = [trainer.scene.camera(view) for view in trainer.scene.train]
    eyes = np.stack([camera.position for camera in cameras])
    circle = circle_of_cameras(cameras)
    first = first_view(cameras, circle)
    view = next(v for v, c in zip(trainer.scene.train, cameras, strict=True) if c is first)
    anchors, _ = trainer.model.placed()
    poster = poster_of(trainer.scene, view)
    return {
        "scene": trainer.scene.name,
        "generator": f"gsynopsis {__version__}",
        "preset": trainer.config.preset,
        "seed": str(trainer.config.train.seed),
        "scale": f"{trainer.config.scale:g}",
        "units": "those of the photos' camera poses",
        "up": " ".join(f"{value:.6g}" for value in circle.up),
        ORBIT: circle_text(circle),
        FIRST: first_text(first),
        FOCALS: focals_text(trained_focals(trainer)),
        SEEN: seen_text(seen_by(eyes, anchors, trainer.model.frame.extent)),
        **({POSTER: poster} if poster else {}),
    }


def trained_focals(trainer: "Trainer") -> "list[Focals]":
    """Focal lengths of the training photos, of each level at the size at which it was trained.

    While levels are made top down, those there are so far.
    """
    from gsynopsis.render.base import focal_length

    assert trainer.model is not None
    scene, config = trainer.scene, trainer.config
    ranges: list[Focals] = []
    for level in range(config.levels.count)[-len(trainer.model.parts) :]:
        scale = level_scale(config, level)
        lengths = [focal_length(scene.camera(view, scale)) for view in scene.train]
        ranges.append((min(lengths), max(lengths)))
    return ranges


def write_run_record(trainer: "Trainer", scene: Path, out: Path) -> None:
    """`run.json`: how the run came to be; the scene's path is relative to the folder."""
    config = trainer.config
    record = {
        "scene": os.path.relpath(scene.resolve(), out.resolve()),
        "scale": config.scale,
        "split": config.split,
        "preset": config.preset,
        "seed": config.train.seed,
        "steps": total_steps(config),
        "train_seconds": round(trainer.cursor.seconds, 3),
        "version": __version__,
        "config": asdict(config),
    }
    temporary = out / f"{RUN_FILE}.tmp"
    temporary.write_text(json.dumps(record, indent=1) + "\n", "utf-8")
    os.replace(temporary, out / RUN_FILE)


def recorded_config(run: Run) -> Config:
    """The settings a run was made with.

    Raises:
        InputError: the record does not hold them.
    """
    path = run.folder / RUN_FILE
    try:
        values: dict[str, Any] = json.loads(path.read_text("utf-8"))["config"]
        # What the run's version did not have yet was at its default, whatever the preset says now.
        config: Config = config_from_dict(Config(), values)
        check_config(config)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(path, "config", found=error, expected="the settings of a run") from error
    return config


def evaluate_run(out: Path, renderer: Backend, *, as_json: bool, quiet: bool) -> int:
    """Measure a finished run as `gsynopsis evaluate` does."""
    from gsynopsis.cli.evaluate import Evaluate

    return Evaluate(run_path=out, renderer=renderer, json=as_json, quiet=quiet).run()


def make_folder(path: Path) -> None:
    """A folder to write to.

    Raises:
        InputError: it is a file, or may not be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise InputError(path, found=reason, expected="a folder to write to") from error
