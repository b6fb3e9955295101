"""RUN, the folder that `train` fills: `run.json` says how, `scene.gsyn` is the result."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import cast, get_args

from gsynopsis.cli.opening import Split
from gsynopsis.errors import InputError, SettingError

RUN_FILE = "run.json"
RESULT_FILE = "scene.gsyn"


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
    """

    file: Path
    folder: Path
    scene: Path | None = None
    scale: float | None = None
    preset: str | None = None
    seed: int | None = None
    steps: int | None = None
    train_seconds: float | None = None
    split: Split | None = None


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
        known = (path / RUN_FILE).is_file()
        return read_record(path) if known else Run(file=file, folder=path)
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


def read_record(folder: Path) -> Run:
    """What `run.json` says of a run, finished or not.

    Raises:
        InputError: there is no `run.json`, or it cannot be used.
    """
    record = folder / RUN_FILE
    if not record.is_file():
        raise InputError(record, found="nothing", expected="the record of a run")
    values = _read_values(record)
    scene = _text(record, values, "scene")
    return Run(
        file=folder / RESULT_FILE,
        folder=folder,
        # A relative path is relative to where it stands written.
        scene=folder / scene if scene is not None else None,
        scale=_number(record, values, "scale"),
        preset=_text(record, values, "preset"),
        seed=_whole(record, values, "seed"),
        steps=_whole(record, values, "steps"),
        train_seconds=_number(record, values, "train_seconds"),
        split=_split(record, values),
    )


def _read_values(record: Path) -> dict[str, object]:
    try:
        values = json.loads(record.read_text("utf-8"))
    except ValueError as error:
        reason = str(error).splitlines()[0]
        raise InputError(record, found=reason, expected="a JSON object") from error
    if not isinstance(values, dict):
        raise InputError(record, found=type(values).__name__, expected="a JSON object")
    return cast("dict[str, object]", values)


def _text(record: Path, values: dict[str, object], name: str) -> str | None:
    value = values.get(name)
    if value is None or isinstance(value, str):
        return value
    raise InputError(record, name, found=repr(value), expected="a text")


def _split(record: Path, values: dict[str, object]) -> Split | None:
    value = _text(record, values, "split")
    for known in get_args(Split):
        if value == known:
            return known
    if value is None:
        return None
    raise InputError(record, "split", found=value, expected=" or ".join(get_args(Split)))


def _whole(record: Path, values: dict[str, object], name: str) -> int | None:
    value = values.get(name)
    if value is None or (isinstance(value, int) and not isinstance(value, bool)):
        return value
    raise InputError(record, name, found=repr(value), expected="a whole number")


def _number(record: Path, values: dict[str, object], name: str) -> float | None:
    value = values.get(name)
    if value is None:
        return None
    if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
        return float(value)
    raise InputError(record, name, found=repr(value), expected="a finite number")
