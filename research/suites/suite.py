"""A suite, read from TOML and checked before anything is trained.

seeds = [0, 1, 2]
anchor = "plain"                       # BD-rate is against this method

[scenes.fox]
path = "fox"                           # relative to the suite's file, or to --data
scale = 4
images = "images_2"                    # copies of the photos; max_width = 1600 divides wide ones

[scenes.object]
path = "procedural:object"
split = "validation"

[methods.ours]
preset = "standard"

[methods.plain]
preset = "standard"
set = { model.feature = "free", train.steps = 300 }

[methods.paper]
preset = "paper"

[methods.lad]                          # other levels of the full model that another method trains
unfolds = "paper"
set = { levels.ablation = "lad" }

[methods.gode]                         # another method, on as many images as the preset renders
baseline = { name = "gode", rates = 2 }
"""

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import msgspec

from gsynopsis import __version__
from gsynopsis.config import PresetName, Split, config_to_json, resolve_settings
from gsynopsis.config.mismatch import NO_NUL, mismatch
from gsynopsis.errors import GsynopsisError, SettingError
from gsynopsis.files import read_regular
from research.suites.validation_scenes import PROCEDURAL

BaselineName = Literal[
    "gaussians",
    "contribution",
    "decimate",
    "gode",
    "prefix",
    "layers",
    "lapis",
    "mcmc",
    "octree",
]
"""As `baselines.methods.METHODS`, which imports torch."""
PROCEDURAL_PREFIX = "procedural:"
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ,._+-]{0,60}")
"""Pattern for names of scenes and methods: they become names of folders."""
MOST_CELLS = 10_000
SUITE_MOST = 1 << 20
"""Bytes of a suite's file; they are a few thousand."""
DEPTH_MOST = 8
Folder: TypeAlias = Annotated[str, msgspec.Meta(pattern=NO_NUL)]


class SceneEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A scene of a suite: a folder, relative to that of the data, or `procedural:` and a name.

    Photos may be copies in another folder of the scene, as `images_4`, and are divided so that the
    widest has `max_width` pixels. `set` is for all methods; a method's own settings win.
    """

    path: Folder
    scale: float = 1.0
    split: Split = "every8"
    images: Folder = ""
    max_width: Annotated[int, msgspec.Meta(ge=0, le=65_536)] = 0
    set: dict[str, Any] = {}


class Baseline(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Another method, see `research.baselines`: its name, and how it is trained.

    `degree` is that of the harmonics, `per_pixel` the most Gaussians per pixel of a photo in place
    of the preset's.
    """

    name: BaselineName
    rates: Annotated[float, msgspec.Meta(gt=0, le=100)] = 1.0
    reset: bool = True
    degree: Annotated[int, msgspec.Meta(ge=0, le=3)] = 3
    per_pixel: Annotated[float, msgspec.Meta(ge=0, le=1000)] = 0.0


class MethodEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A method: a preset, else `standard`, and changes to it; settings by dotted name or as tables.

    A baseline takes steps from them and renders as many images. A method that unfolds makes levels
    from the full model of another one, whose preset and settings are its own but for those of
    levels that it changes.
    """

    preset: PresetName | None = None
    set: dict[str, Any] = {}
    baseline: Baseline | None = None
    unfolds: str = ""


class SuiteFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Contents of a suite's file."""

    scenes: dict[str, SceneEntry]
    methods: dict[str, MethodEntry]
    seeds: tuple[int, ...] = (0,)
    anchor: str = ""


@dataclass(frozen=True)
class Cell:
    """One training: a scene, a method and a seed.

    Attributes:
        scene: Name of the scene.
        method: Name of the method.
        seed: Seed of the training.
        path: Folder of the scene, or `procedural:` and a name.
        preset: Preset of the method.
        asked: Settings that differ from the preset, by dotted name; with scale, split and seed.
        baseline: Trained instead, if any.
        images: Folder of the photos in the scene's; empty: the default one.
        max_width: Most pixels that the widest photo may have; 0: no limit.
        unfolds: Cell whose full model it takes, if it does not train its own.
        lpips: File with the weights of LPIPS, which is measured then; empty: it is not.
    """

    scene: str
    method: str
    seed: int
    path: str
    preset: PresetName
    asked: Mapping[str, Any] = field(default_factory=dict[str, Any])
    baseline: Baseline | None = None
    images: str = ""
    max_width: int = 0
    unfolds: "Cell | None" = None
    lpips: str = ""

    @property
    def stem(self) -> str:
        """Short and readable, not unlike those of other settings."""
        return f"{self.scene}-{self.method}-{self.seed}".replace(", ", "_").replace(" ", "_")

    @property
    def name(self) -> str:
        """Name of its folder: other settings, or another version, are another cell."""
        baseline = [msgspec.to_builtins(self.baseline)] if self.baseline else []
        return f"{self.stem}-{self._digest(baseline)}"

    @property
    def grown(self) -> str:
        """Name of the folder with Gaussians that baselines of the same scene and seed share."""
        assert self.baseline
        asked = msgspec.to_builtins(self.baseline)
        return f"{self.scene}-{self._digest([v for n, v in asked.items() if n != 'name'])}"

    def _digest(self, baseline: list[Any]) -> str:
        config = resolve_settings(self.preset, None, dict(self.asked)).config
        said = [__version__, self.path, self.preset, config_to_json(config), *baseline]
        if self.images or self.max_width:
            said += [self.images, str(self.max_width)]
        if self.lpips:
            said.append("lpips")
        return hashlib.sha256(json.dumps(said).encode()).hexdigest()[:8]


@dataclass(frozen=True)
class Suite:
    """All cells, and the method that others are compared with."""

    cells: tuple[Cell, ...]
    anchor: str


def _entries_of(path: Path) -> SuiteFile:
    """Contents of a suite's file, decoded.

    Raises:
        SettingError: the file is not a suite.
    """
    try:
        return msgspec.toml.decode(
            read_regular(path, SUITE_MOST, SettingError, "a suite in TOML"), type=SuiteFile
        )
    except msgspec.ValidationError as error:
        wrong = mismatch(error)
        raise SettingError(path, wrong.name, found=wrong.text) from error
    except (msgspec.DecodeError, ValueError, RecursionError) as error:
        raise SettingError(path, found=error, expected="a suite in TOML") from error


def read_suite(
    path: Path,
    data: Path | None = None,
    only: Sequence[str] = (),
    seeds: Sequence[int] = (),
    lpips: Path | None = None,
) -> Suite:
    """A suite from its file, seeds outermost, so that a stop leaves whole comparisons.

    Args:
        path: The file.
        data: Folder that scenes' paths are relative to; None: the file's own.
        only: Names of the scenes to take; empty: all.
        seeds: To take; empty: all.
        lpips: Weights of LPIPS, which all cells measure then; None: none does.

    Raises:
        SettingError: the file is none, or names a scene, preset or setting that there is not.
    """
    entries = _entries_of(path)
    _check_depths(path, entries)
    _check_names(path, entries)
    for name in only:
        if name not in entries.scenes:
            expected = " or ".join(entries.scenes)
            raise SettingError("--only", found=ascii(name[:80]), expected=expected)
    for seed in seeds:
        if seed not in entries.seeds:
            expected = " or ".join(map(str, entries.seeds))
            raise SettingError("--seeds", found=seed, expected=expected)
    scenes = {name: s for name, s in entries.scenes.items() if not only or name in only}
    data = data or path.parent
    for name, scene in scenes.items():
        _check_scene(path, name, scene, data)
    cells = [
        _cell(entries, name, method, seed, _place(data, scene))
        for seed in entries.seeds
        if not seeds or seed in seeds
        for name, scene in scenes.items()
        for method in entries.methods
    ]
    if lpips is not None:
        cells = [replace(cell, lpips=str(lpips.resolve())) for cell in cells]
    for cell in cells:
        _check_settings(path, cell)
    return Suite(tuple(cells), entries.anchor or next(iter(entries.methods)))


def _cell(entries: SuiteFile, name: str, method: str, seed: int, place: str) -> Cell:
    """A cell, with the one whose full model it takes."""
    scene, entry = entries.scenes[name], entries.methods[method]
    source = _cell(entries, name, entry.unfolds, seed, place) if entry.unfolds else None
    own = dict(_flat(entry.set, ""))
    return Cell(
        name,
        method,
        seed,
        place,
        source.preset if source else entry.preset or "standard",
        {**source.asked, **own} if source else _asked(entry, scene, seed),
        entry.baseline,
        scene.images,
        scene.max_width,
        source,
    )


def _check_settings(path: Path, cell: Cell) -> None:
    """Check that a cell's settings are valid and match those of the full model that it takes."""
    where = f"methods.{cell.method}"
    try:
        own = resolve_settings(cell.preset, None, dict(cell.asked)).config
    except GsynopsisError as error:
        raise SettingError(path, where, found=error) from error
    if cell.unfolds:
        full = resolve_settings(cell.preset, None, dict(cell.unfolds.asked)).config
        if replace(own, levels=full.levels) != full:
            found, expected = "a change of the full model", "settings of levels alone"
            raise SettingError(path, where, found=found, expected=expected)


def _check_names(path: Path, entries: SuiteFile) -> None:
    for kind, names in (("scenes", entries.scenes), ("methods", entries.methods)):
        if not names:
            raise SettingError(path, kind, found="none", expected="at least one")
        for name in names:
            if not NAME.fullmatch(name):
                expected = "letters, digits, spaces and ,._+-"
                raise SettingError(path, kind, found=ascii(name[:80]), expected=expected)
    for name, entry in entries.methods.items():
        if entry.unfolds:
            _check_unfolds(path, entries, name)
    if entries.anchor and entries.anchor not in entries.methods:
        expected = " or ".join(entries.methods)
        raise SettingError(path, "anchor", found=entries.anchor, expected=expected)
    if not entries.seeds or len(set(entries.seeds)) < len(entries.seeds):
        raise SettingError(path, "seeds", found=entries.seeds, expected="different seeds")
    count = len(entries.seeds) * len(entries.scenes) * len(entries.methods)
    if count > MOST_CELLS:
        raise SettingError(path, found=f"{count} cells", expected=f"at most {MOST_CELLS}")


def _check_depths(path: Path, entries: SuiteFile) -> None:
    """Settings are nested no deeper than any are: each level is a call."""
    for kind, named in (("scenes", entries.scenes), ("methods", entries.methods)):
        for name, entry in named.items():
            tables: list[Any] = [entry.set]
            for _ in range(DEPTH_MOST):
                tables = [v for t in tables for v in t.values() if isinstance(v, dict)]
            if tables:
                found, expected = f"more than {DEPTH_MOST} tables in each other", "settings"
                raise SettingError(path, f"{kind}.{name}.set", found=found, expected=expected)


def _check_unfolds(path: Path, entries: SuiteFile, name: str) -> None:
    """Check that the method to unfold from trains a full model itself."""
    entry = entries.methods[name]
    trained = [n for n, m in entries.methods.items() if not m.unfolds and not m.baseline]
    if entry.unfolds not in trained:
        expected = " or ".join(trained) or "a method with a preset"
        raise SettingError(path, f"methods.{name}.unfolds", found=entry.unfolds, expected=expected)
    if entry.baseline or entry.preset:
        found = "a baseline" if entry.baseline else entry.preset
        expected = f"what {entry.unfolds} has"
        raise SettingError(path, f"methods.{name}", found=found, expected=expected)


def _check_scene(path: Path, name: str, scene: SceneEntry, data: Path) -> None:
    where, place = f"scenes.{name}.path", _place(data, scene)
    known = place.removeprefix(PROCEDURAL_PREFIX)
    if known != place:
        if known not in PROCEDURAL:
            raise SettingError(path, where, found=known, expected=" or ".join(PROCEDURAL))
    elif not Path(place).is_dir():
        advice = "say with --data where the scenes are, or with --only which to take"
        found, expected = f"no folder {place}", "that of a scene"
        raise SettingError(path, where, found=found, expected=expected, advice=advice)


def _place(data: Path, scene: SceneEntry) -> str:
    if scene.path.startswith(PROCEDURAL_PREFIX):
        return scene.path
    return str((data / scene.path).resolve())


def _asked(method: MethodEntry, scene: SceneEntry, seed: int) -> dict[str, Any]:
    return {
        **dict(_flat(scene.set, "")),
        **dict(_flat(method.set, "")),
        "scale": scene.scale,
        "split": scene.split,
        "train.seed": seed,
    }


def _flat(tables: Mapping[str, Any], above: str) -> Iterator[tuple[str, Any]]:
    """Values of nested tables by dotted name."""
    for name, value in tables.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", value
