"""A level of a file as other programs' files: baked, fine-tuned, measured, written."""

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from statistics import fmean
from typing import Literal

import numpy as np
import torch

from gsynopsis.cameras.orbit import circle_of_levels, default_lens, first_camera, orbit, sized
from gsynopsis.container.writer import publish
from gsynopsis.errors import InputError, SettingError
from gsynopsis.evaluation.load_model import Opened, open_levels
from gsynopsis.evaluation.metrics import psnr
from gsynopsis.evaluation.protocols import Decoder, LevelRenderer
from gsynopsis.formats.axes import (
    DOWN,
    UP,
    Up,
    matrix_of,
    nearest_axis,
    parse_up,
    turn_between,
    turned,
    up_text,
)
from gsynopsis.formats.writers.forge import forge_bytes
from gsynopsis.formats.writers.glb import glb_bytes
from gsynopsis.formats.writers.packed import packed_bytes
from gsynopsis.formats.writers.ply import ply_bytes
from gsynopsis.formats.writers.sog import sog_bytes, zipped
from gsynopsis.formats.writers.ssog import INDEX, ssog_files
from gsynopsis.formats.writers.usd import usd_bytes
from gsynopsis.jobs.export_finetune import FineTuning, Shot, fine_tune
from gsynopsis.model.bake import Baking, bake
from gsynopsis.model.plain import PlainModel
from gsynopsis.model.splats import SplatModel, plain_level
from gsynopsis.records import SHIFT_NOTE, LevelSet, PlainGaussians
from gsynopsis.render.choose import RendererName
from gsynopsis.runs.folder import Run
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene

Format = Literal["ply", "compressed-ply", "spz", "spz3", "sog", "ssog", "glb", "usd"]
ENDINGS: Mapping[Format, str] = {
    "ply": ".ply",
    "compressed-ply": ".compressed.ply",
    "spz": ".spz",
    "spz3": ".v3.spz",
    "sog": ".sog",
    "ssog": ".ssog",
    "glb": ".glb",
    "usd": ".usdc",
}
"""Ending of a file's name by format."""
Y_UP: tuple[Format, ...] = ("spz", "spz3", "glb", "usd")
WORLDS = tuple(name for name in ENDINGS if name not in Y_UP)
"""Formats whose axes are those of the camera poses."""
ORBIT = 64
"""Cameras from which a file without photos is baked (ours)."""
LENS_WIDTH = 320
"""Pixels of their pictures: blend weights need no more (ours)."""
STEPS_DEFAULT = 1000
"""Steps of fine-tuning where there are photos (ours: fox loses nothing at level 3 then)."""
Watch = Callable[[str], AbstractContextManager[Callable[[int, int], None]]]
"""Shows the progress of what is named, for a `with` block."""


@dataclass(frozen=True)
class Exporting:
    """Options of an export.

    Attributes:
        format: Of the files.
        levels: Which levels, 0 is the coarsest; the finest if empty.
        baking: How Gaussians are baked.
        steps: Of fine-tuning on the training photos; 0: none.
        overwrite: Replace files that are there.
        renderer: Rasteriser.
    """

    format: Format = "ply"
    levels: tuple[int, ...] = ()
    baking: Baking = field(default_factory=Baking)
    steps: int = 0
    overwrite: bool = False
    renderer: RendererName = "auto"


@dataclass(frozen=True)
class Stages:
    """Mean PSNR on held-out photos at the size of the training, dB: what each stage leaves of it.

    Attributes:
        anchors: Of the level itself.
        baked: Of its Gaussians.
        tuned: Of these after fine-tuning; None without.
    """

    anchors: float
    baked: float
    tuned: float | None = None


@dataclass(frozen=True)
class Baked:
    """A level as plain Gaussians, and how well they show the scene; None without photos.

    Attributes:
        level: Which.
        gaussians: Of the level.
        stages: Quality; None without photos.
        up: Away from the ground, in the axes of the Gaussians.
        note: How they were turned; "" if they were not.
        shift: What was taken from their positions, in their axes.
    """

    level: int
    gaussians: PlainGaussians
    stages: Stages | None
    up: Up = DOWN
    note: str = ""
    shift: Up = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Exported:
    """One file that was written.

    Attributes:
        path: The file.
        level: Its level.
        gaussians: How many it holds.
        bytes: Its size.
        stages: Quality of each stage; None without photos.
        notes: How axes were turned, a line; none if they were not.
    """

    path: Path
    level: int
    gaussians: int
    bytes: int
    stages: Stages | None
    notes: tuple[str, ...] = ()


def no_watch(what: str) -> AbstractContextManager[Callable[[int, int], None]]:
    """Shows nothing."""
    return nullcontext(lambda done, total: None)


def export(
    run: Run,
    out: Path,
    exporting: Exporting,
    photos: "Photographed | None",
    watch: Watch = no_watch,
) -> list[Exported]:
    """Write levels of a file in another program's format, and a record beside each.

    Args:
        run: The file, and what is known of it.
        out: A folder, or the name of the file if that has the format's ending and one level is
            asked for.
        exporting: What and how.
        photos: The scene and the scale of its photos; None: baked from the cameras that the file
            knows, not fine-tuned, not measured.
        watch: Shows progress.

    Raises:
        InputError: a file is there already, or the file is damaged.
        SettingError: there is no such level, or photos are needed that nobody has.
        SpaceError: the disk is full.
    """
    if exporting.steps and photos is None:
        raise SettingError("--fine-tune", found="no photos", expected="--scene and --scale")
    opened = open_levels(run.file, exporting.renderer)
    count = len(opened.levels.levels)
    streamed = exporting.format == "ssog"
    levels = tuple(range(count)) if streamed else chosen_levels(exporting.levels, count)
    if streamed:
        paths = [out if out.suffix == ".ssog" else out / f"{run.file.stem}_ssog" / INDEX]
    else:
        paths = [path_of(out, run.file, exporting.format, level, levels) for level in levels]
    for path in paths:
        _check_free(path, exporting.overwrite)
    baked = (
        in_axes(
            bake_level(opened, level, exporting, photos, watch), opened.levels, exporting.format
        )
        for level in levels
    )
    if streamed:
        return [_write_streamed(paths[0], [*baked], exporting, opened.levels)]
    return [_write_level(path, one, exporting) for path, one in zip(paths, baked, strict=True)]


def _check_free(path: Path, overwrite: bool) -> None:
    if path.exists() and not overwrite:
        advice = "give --overwrite to replace it"
        raise InputError(path, found="a file", expected="none", advice=advice)


def _write_level(path: Path, baked: Baked, exporting: Exporting) -> Exported:
    if not len(baked.gaussians):
        raise InputError(path, found="no Gaussians", expected="a level that cameras see")
    antialiased = exporting.baking.antialiased
    data = encoded(baked.gaussians, exporting.format, antialiased, baked.up, baked.shift)
    _publish(data, path)
    notes = _notes(baked, exporting.format)
    exported = Exported(path, baked.level, len(baked.gaussians), len(data), baked.stages, notes)
    _publish(record_text([exported], exporting).encode(), path.with_name(path.name + ".json"))
    return exported


def _write_streamed(
    path: Path, baked: Sequence[Baked], exporting: Exporting, levels: LevelSet
) -> Exported:
    """All levels as streamed SOG: a folder, its index last, or one file."""
    errors = picture_errors(baked, levels)
    gaussians = [one.gaussians for one in baked]
    files = ssog_files(gaussians, errors, antialiased=exporting.baking.antialiased)
    size = sum(map(len, files.values()))
    if path.name == INDEX:
        for name in reversed(files):
            _publish(files[name], path.parent / name)
    else:
        data = zipped(files)
        size = len(data)
        _publish(data, path)
    total = sum(len(one.gaussians) for one in baked)
    notes = _notes(baked[-1], exporting.format)
    exported = Exported(path, baked[-1].level, total, size, baked[-1].stages, notes)
    beside = path.parent if path.name == INDEX else path
    record = beside.with_name(beside.name + ".json")
    _publish(record_text([exported], exporting).encode(), record)
    return exported


def _notes(baked: Baked, name: Format) -> tuple[str, ...]:
    """Lines on how a level's axes and origin are not those of the input."""
    lines = [baked.note] if baked.note else []
    if any(baked.shift) and name != "ply":
        x, y, z = baked.shift
        lines.append(
            f"positions are less by ({x:.15g} {y:.15g} {z:.15g}): PLY alone has them whole"
        )
    return tuple(lines)


def _publish(data: bytes, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    publish(data, path)


def in_axes(baked: Baked, levels: LevelSet, name: Format) -> Baked:
    """The Gaussians in the axes of 3DGS, y down, from which writers turn them to those of a format.

    Splats of another program are turned to them for every format. What was trained from photos
    keeps the world of their poses in PLY and SOG; where y has to be up its nearest axis goes there.
    """
    up = parse_up(levels.meta.get("up", "")) or DOWN
    shift = shift_of(levels)
    baked = replace(baked, shift=shift)
    imported = levels.shared.degree is not None
    if not imported and name in WORLDS:
        return replace(baked, up=up)
    start = up if imported else nearest_axis(up)
    if start == DOWN:
        return baked
    turn = turn_between(start, DOWN)
    way, axis = ("up", UP) if name in Y_UP else ("down", DOWN)
    note = "" if start == axis else f"turned: up was {up_text(start)}, {name} has y {way}"
    x, y, z = (matrix_of(turn) @ shift).tolist()
    gaussians = turned(baked.gaussians, turn)
    return replace(baked, gaussians=gaussians, note=note, shift=(x, y, z))


def shift_of(levels: LevelSet) -> Up:
    """The move that a file's input was given: taken from positions; 0 without a note of it."""
    try:
        x, y, z = (float(word) for word in levels.meta.get(SHIFT_NOTE, "0 0 0").split())
    except ValueError:
        return 0.0, 0.0, 0.0
    return (x, y, z) if np.isfinite([x, y, z]).all() else (0.0, 0.0, 0.0)


def encoded(
    gaussians: PlainGaussians,
    name: Format,
    antialiased: bool,
    up: Up = DOWN,
    shift: Up = (0.0, 0.0, 0.0),
) -> bytes:
    """A file of Gaussians, at least one.

    Args:
        gaussians: In the axes of 3DGS, y down, but in formats that can say another up: PLY.
        name: Of the format.
        antialiased: They are to be drawn so.
        up: Of the Gaussians.
        shift: Added to positions in PLY, which holds doubles; others have no room for them.

    Raises:
        MissingExtraError: a library that writes the format is not installed.
    """
    if name == "ply":
        return ply_bytes(gaussians, antialiased=antialiased, up=up, shift=shift)
    if name == "compressed-ply":
        return packed_bytes(gaussians, up=up)
    if name == "glb":
        return glb_bytes(gaussians)
    if name == "usd":
        return usd_bytes(gaussians)
    if name == "sog":
        return sog_bytes(gaussians, antialiased=antialiased)
    assert name != "ssog", "it holds several levels"
    return forge_bytes(gaussians, name)


def picture_errors(baked: Sequence[Baked], levels: LevelSet) -> list[float] | None:
    """Growth of each level's error on held-out photos over that of the finest.

    Root mean square over [0, 1], from what was measured here, else from what the file states;
    None where neither is known.
    """
    stages = [one.stages for one in baked]
    known = [s and (s.baked if s.tuned is None else s.tuned) for s in stages]
    stated = [level.quality.get("psnr_full") for level in levels.levels]
    decibels = [value for value in (known if None not in known else stated) if value is not None]
    if len(decibels) < len(baked):
        return None
    errors = [10 ** (-value / 20) for value in decibels]
    return [max(0.0, error - errors[-1]) for error in errors]


@dataclass(frozen=True)
class Photographed:
    """Photos of a scene at the scale of its training."""

    scene: Scene
    scale: float

    def cameras(self) -> list[Camera]:
        """Those of training."""
        return [self.scene.camera(view, self.scale) for view in self.scene.train]

    def shot(self, number: int) -> Shot:
        """Camera and photo of a training view, on the CPU."""
        view = self.scene.train[number]
        pixels = torch.from_numpy(self.scene.image(view, self.scale).copy())
        return Shot(self.scene.camera(view, self.scale), pixels.float() / 255)


def photographed(folder: Path, scale: float, split: str) -> Photographed:
    """Photos of a scene in a folder.

    Raises:
        SceneError: the scene cannot be used.
    """
    return Photographed(load_scene(folder, split), scale)  # type: ignore[arg-type]


def bake_level(
    opened: Opened,
    level: int,
    exporting: Exporting,
    photos: Photographed | None,
    watch: Watch = no_watch,
) -> Baked:
    """A level as plain Gaussians, measured after each stage where there are photos.

    The splats of a file that holds plain ones are taken as they are.
    """
    cameras = photos.cameras() if photos else known_cameras(opened.levels)
    if isinstance(opened.decoder, SplatModel):
        splats = plain_level(opened.levels, level)
        coefficients = (exporting.baking.degree + 1) ** 2
        return Baked(level, replace(splats, sh=splats.sh[:, :coefficients]), None)
    with watch(f"baking L{level}") as tick:
        gaussians = bake(opened.decoder, level, cameras, opened.renderer, exporting.baking, tick)
    if photos is None:
        return Baked(level, gaussians, None)
    antialiased, device = exporting.baking.antialiased, opened.renderer.device
    model = PlainModel(gaussians, antialiased=antialiased).to(device)
    before = mean_psnr(opened, opened.decoder, level, photos)
    baked = mean_psnr(opened, model, level, photos)
    if not exporting.steps or not len(gaussians):
        return Baked(level, gaussians, Stages(before, baked))

    def shot(number: int) -> Shot:
        own = photos.shot(number)
        return own._replace(picture=own.picture.to(device))

    tuning = FineTuning(exporting.steps, photos.scene.extent)
    with watch(f"fine-tuning L{level}") as tick:
        views = len(photos.scene.train)
        gaussians = fine_tune(model, views, shot, opened.renderer, tuning, tick)
    tuned = mean_psnr(opened, model, level, photos)
    return Baked(level, gaussians, Stages(before, baked, tuned))


def mean_psnr(opened: Opened, decoder: Decoder, level: int, photos: Photographed) -> float:
    """Mean PSNR on the held-out photos at the size of the training, 8 bits, dB."""
    painter = LevelRenderer(decoder, opened.renderer)
    scene, scale = photos.scene, photos.scale
    with torch.no_grad():
        return fmean(
            psnr(painter.paint(scene.camera(view, scale), level), scene.image(view, scale))
            for view in scene.test
        )


def known_cameras(levels: LevelSet) -> list[Camera]:
    """Cameras near those of the training, as far as a file knows them: a round, the first view."""
    first = first_camera(levels.meta)
    lens = sized(first or default_lens(), LENS_WIDTH, None)
    cameras = orbit(circle_of_levels(levels), lens, ORBIT)
    return [*cameras, lens] if first else cameras


def chosen_levels(asked: Sequence[int], count: int) -> tuple[int, ...]:
    """Numbers of levels, ascending, each once; the finest if none are asked for.

    Raises:
        SettingError: the file has no such level.
    """
    for level in asked:
        if not 0 <= level < count:
            raise SettingError("--level", found=level, expected=f"0 to {count - 1}")
    return tuple(sorted(set(asked))) or (count - 1,)


def path_of(out: Path, file: Path, name: Format, level: int, levels: Sequence[int]) -> Path:
    """Path of a level: `out` itself if it is a file's name, else a name of its own in there.

    Raises:
        SettingError: several levels are to go to one file.
    """
    ending = ENDINGS[name]
    if not out.name.endswith(ending):
        return out / f"{file.stem}_L{level}{ending}"
    if len(levels) > 1:
        raise SettingError("--out", found=f"one file, {len(levels)} levels", expected="a folder")
    return out


def record_text(written: Sequence[Exported], exporting: Exporting) -> str:
    """Facts of the written files, for JSON."""
    values = {
        "format": exporting.format,
        "baking": asdict(exporting.baking),
        "fine_tune_steps": exporting.steps,
        "files": [{**asdict(one), "path": one.path.name} for one in written],
    }
    return json.dumps(values, indent=1) + "\n"
