"""RUN, the folder that `train` fills: `run.json` says how, `scene.gsyn` is the result."""

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import msgspec
from msgspec import Meta

from gsynopsis import __version__
from gsynopsis.config import (
    Config,
    PresetName,
    Recipe,
    Split,
    config_from_json,
    total_steps,
    values_of,
)
from gsynopsis.config.mismatch import NO_NUL, mismatch
from gsynopsis.config.presets import RECORDED, RecordedName
from gsynopsis.errors import GsynopsisError, InputError, SettingError
from gsynopsis.files import publish, read_regular
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import DEFAULT_OPTIONS, Scene, SceneOptions

if TYPE_CHECKING:
    from gsynopsis.evaluation.report import Report
    from gsynopsis.runs.gsyn_file import File

RUN_FILE = "run.json"
RESULT_FILE = "scene.gsyn"
RECORD_MOST = 1 << 20
"""Bytes of a record; they are a few thousand."""
Seconds: TypeAlias = Annotated[float, Meta(ge=0, le=1e12)]


@dataclass(frozen=True)
class Record:
    """Content of `run.json`; older ones lack some of it."""

    scene: Annotated[str, Meta(pattern=NO_NUL)] | None = None
    """Folder of the scene, relative to the run's."""
    scale: Annotated[float, Meta(ge=1, le=65_536)] | None = None
    split: Split | None = None
    preset: RecordedName | None = None
    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] | None = None
    steps: Annotated[int, Meta(ge=0, le=2**53)] | None = None
    """Training steps in all."""
    train_seconds: Seconds | None = None
    phase_seconds: dict[str, Seconds] = field(default_factory=dict[str, float])
    """Training time of each finished phase: `full`, and `joint` or `unfold L2` and so on."""
    version: str | None = None
    config: dict[str, Any] | None = None
    asked: list[str] = field(default_factory=list[str])
    """Dotted names of the settings that were asked for."""
    reading: SceneOptions = DEFAULT_OPTIONS
    """Options with which the scene's folder was read."""
    followed: dict[str, str] = field(default_factory=dict[str, str])
    """Why settings are not the preset's, by dotted name."""


@dataclass(frozen=True)
class Run:
    """A trained file, and what is known about how it came to be; None where nothing is.

    Attributes:
        file: The `.gsyn` file.
        folder: Where results belong: the run's folder, or the file's.
        scene: The scene it was trained on.
        scale: The photos' size was divided by this.
        preset: Preset of the training.
        seed: Seed of the training.
        steps: Training steps in all.
        train_seconds: Training time in all, seconds.
        split: The rule that chose the held-out views.
        reading: Options with which the scene's folder was read.
        report: Evaluation that the training just wrote, if it was ordered.

    Examples:
        >>> scene = gs.load_scene("scene")
        >>> recipe = gs.resolve("standard", scene, {"train.steps": 30, "levels.steps": 50})
        >>> run = gs.train(scene, recipe, "runs/room")  # what is trained already is not again
        >>> run
        Run(runs/room: standard, 80 steps on scene)
        >>> with run.open() as file:
        ...     len(file.levels)
        4
    """

    file: Path
    folder: Path
    scene: Path | None = None
    scale: float | None = None
    preset: PresetName | None = None
    seed: int | None = None
    steps: int | None = None
    train_seconds: float | None = None
    split: Split | None = None
    reading: SceneOptions = DEFAULT_OPTIONS
    report: "Report | None" = field(default=None, compare=False)

    def __repr__(self) -> str:
        known = [self.preset, f"{self.steps:,} steps" if self.steps else None]
        told = ", ".join(filter(None, known)) or "no record"
        where = f" on {self.scene.name}" if self.scene else ""
        return f"Run({self.folder}: {told}{where})"

    def open(self) -> "File":
        """The trained file, ready to be rendered.

        Raises:
            InputError: it is not there yet, or damaged.
        """
        # Late: what `info` reads of a run needs no reader of files.
        from gsynopsis.runs.gsyn_file import open_source

        return open_source(self.file)


def find_run(path: Path) -> Run:
    """A run's folder, or a single `.gsyn` file of which nothing more is known.

    Raises:
        InputError: there is no such file, or `run.json` cannot be used.
    """
    if path.is_dir():
        file = path / RESULT_FILE
        if not file.is_file():
            advice = f"train it first: gsynopsis train SCENE --out {path}"
            found = f"no {RESULT_FILE}"
            raise InputError(path, found=found, expected="a finished run", advice=advice)
        known = os.path.lexists(path / RUN_FILE)
        return read_run(path) if known else Run(file=file, folder=path)
    if not path.exists():
        raise InputError(path, expected="a .gsyn file or the folder of a run", found="nothing")
    return Run(file=path, folder=path.parent)


def scene_of(
    run: Run, scene: Path | None, scale: float | None, split: Split | None
) -> tuple[Path, float, Split]:
    """Scene, scale and split: what the options say, else what the run knows.

    Raises:
        SettingError: neither knows the scene or the scale.
    """
    scene = run.scene if scene is None else scene
    scale = run.scale if scale is None else scale
    if scene is None:
        raise SettingError("--scene", expected="the folder of the scene", found="nothing")
    if scale is None:
        raise SettingError("--scale", expected="the scale of the training", found="nothing")
    return scene, scale, split or run.split or "every8"


def scene_of_run(run: Run, split: Split) -> Scene:
    """The scene that a run was trained on, read as it was read then.

    Raises:
        SceneError: it is not there any more, or cannot be used.
        SettingError: the run does not know it.
    """
    if run.scene is None:
        raise SettingError(run.folder, "scene", found="nothing", expected="a scene's path")
    return load_scene(run.scene, split, run.reading)


def read_run(folder: Path) -> Run:
    """Run as `run.json` describes it, finished or not.

    Raises:
        InputError: there is no `run.json`, or it cannot be used.
    """
    record = read_record(folder)
    return Run(
        file=folder / RESULT_FILE,
        folder=folder,
        # A relative path is relative to where it stands written.
        scene=folder / record.scene if record.scene is not None else None,
        scale=record.scale,
        preset=RECORDED[record.preset] if record.preset else None,
        seed=record.seed,
        steps=record.steps,
        train_seconds=record.train_seconds,
        split=record.split,
        reading=record.reading,
    )


def read_record(folder: Path) -> Record:
    """The record of a run.

    Raises:
        InputError: there is none, or it cannot be used.
    """
    path = folder / RUN_FILE
    if not os.path.lexists(path):
        raise InputError(path, found="nothing", expected="the record of a run")
    try:
        return msgspec.json.decode(read_regular(path, RECORD_MOST, links=False), type=Record)
    except msgspec.ValidationError as error:
        wrong = mismatch(error)
        raise InputError(path, wrong.name, found=wrong.found, expected=wrong.expected) from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(path, found=error, expected="a JSON object") from error


def recorded_config(folder: Path) -> Config:
    """The settings that a run was made with.

    Raises:
        InputError: the record does not hold them, or not such as this version can use.
    """
    path, values = folder / RUN_FILE, read_record(folder).config
    if values is None:
        raise InputError(path, "config", found="nothing", expected="the settings of a run")
    try:
        return config_from_json(json.dumps(values))
    except (GsynopsisError, RecursionError) as error:
        raise InputError(path, "config", found=error, expected="the settings of a run") from error


def write_record(
    folder: Path,
    scene: Scene,
    config: Config,
    recipe: Recipe,
    *,
    seconds: float = 0.0,
    phase_seconds: Mapping[str, float] | None = None,
) -> None:
    """Write `run.json`, whole or not at all; the scene's path is relative to the folder.

    Args:
        folder: Of the run.
        scene: Whose folder and reading are noted.
        config: What the training runs with: the recipe's, within the limits of this machine.
        recipe: Where its settings come from.
        seconds: Training time in all.
        phase_seconds: Of it, what each finished phase took.
    """
    record = Record(
        scene=os.path.relpath(scene.root.resolve(), folder.resolve()),
        scale=config.scale,
        split=config.split,
        preset=recipe.preset,
        seed=config.train.seed,
        steps=total_steps(config),
        train_seconds=round(seconds, 3),
        phase_seconds={name: round(took, 3) for name, took in (phase_seconds or {}).items()},
        version=__version__,
        config=values_of(config),
        asked=sorted(recipe.asked),
        followed=dict(recipe.followed),
        reading=scene.reading,
    )
    publish(folder / RUN_FILE, json.dumps(asdict(record), indent=1) + "\n")


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
