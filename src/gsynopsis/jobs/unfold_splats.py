"""A finished splat to trained levels, without its photos: its renders are what is trained on.

RUN/renders is a scene like any other, so all that is said of a run holds for this one: it can be
evaluated, packed and unfolded again.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from gsynopsis._native.runtime import one_torch_thread, release_freed
from gsynopsis.cameras.placement import shown
from gsynopsis.cameras.sheet import sheet_path
from gsynopsis.cameras.viewpoints import Viewpoints
from gsynopsis.errors import InputError, SettingError
from gsynopsis.evaluation.report import Report
from gsynopsis.files import inner_folder, publish, read_regular, refuse_link
from gsynopsis.formats.axes import Up
from gsynopsis.formats.readers.any import read_splats
from gsynopsis.formats.readers.base import SplatFile, rows_of
from gsynopsis.jobs.fit_stand_ins import around
from gsynopsis.jobs.import_splats import memory_line, splat_model, without_coarse
from gsynopsis.jobs.options import RunOptions
from gsynopsis.jobs.splat_views import Known, evenly, known_cameras, sheet_of, splat_views
from gsynopsis.jobs.train_run import make_context, tell_plan, train_run
from gsynopsis.model.build import make_frame
from gsynopsis.model.splats import SplatModel
from gsynopsis.records import PlainGaussians
from gsynopsis.render.base import Renderer
from gsynopsis.render.choose import fresh, take_device
from gsynopsis.runs.folder import RUN_FILE, make_folder
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.views import moved
from gsynopsis.teacher.anchors import colors_of, fitted_model
from gsynopsis.teacher.clusters import Clusters, clustered, clusters_of, lattice_cell
from gsynopsis.teacher.photos import ScenePhotos
from gsynopsis.teacher.ranking import worth_of
from gsynopsis.teacher.renders import (
    TRANSFORMS,
    RenderedAlpha,
    is_render,
    write_renders,
    write_scene,
)
from gsynopsis.teacher.settings import PER_ANCHOR, VIEWS, teacher_recipe
from gsynopsis.training.checkpoint import save_checkpoint
from gsynopsis.training.context import TrainContext
from gsynopsis.training.loop import CHECKPOINT
from gsynopsis.training.observer import Observer
from gsynopsis.training.state import TrainState, new_state

RENDERS, TEACHER, SHEET_OF = "renders", "teacher.json", "scene"
"""In a run's folder, a scene of renders; in that, of what and how they are; and the name that the
contact sheet of cameras begins with, as the file does."""
RANKING_VIEWS = 32
"""Cameras from which splats are weighed."""
FEWEST = 16
"""Splats that there have to be to train something."""
FEWEST_VIEWS = 8
"""Cameras likewise."""
SHOWING = 1e-9
"""Share of the largest removal effect below which a splat is not copied."""


@dataclass(frozen=True)
class Teaching:
    """Renders of an input that stand for photos.

    Attributes:
        views: Renders to train on; of cameras that are given without `scene` all are taken.
        width: Of renders, pixels; they are 16 : 9.
        up: Away from the ground in the axes of the input; None: as the file says, else as found.
        cameras: A cameras.json of 3DGS, a COLMAP model or a transforms.json of the same world;
            None: those of `scene`, else those beside the source, else such as are found.
        scene: Of the photos that the splats were made of: its training photos teach beside the
            renders, and reports are from its held-out ones; None: renders alone.
        held_out: Renders to report from, and as many to choose settings by.
    """

    views: int = VIEWS
    width: int = 480
    up: Up | None = None
    cameras: Path | None = None
    scene: Path | None = None
    held_out: int = 16


@dataclass(frozen=True)
class Copied:
    """Splats of an input that anchors begin as.

    Attributes:
        splats: Those that show, G.
        weights: How much each counts, float64 [G].
        clusters: Of them.
        voxel: Lattice cell, world units.
    """

    splats: PlainGaussians
    weights: NDArray[np.float64]
    clusters: Clusters
    voxel: float


class FromSplats:
    """A model that begins as the splats it copies, and lets go of them then."""

    def __init__(self, copied: Copied) -> None:
        """Begin with splats in clusters."""
        self.copied: Copied | None = copied

    def prepare(self, context: TrainContext, out: Path) -> str:
        """See `Start`."""
        copied, self.copied = self.copied, None
        if copied is None or (out / CHECKPOINT).exists():
            return ""
        state = begun_state(context, copied)
        save_checkpoint(state, out / CHECKPOINT)
        return f"{len(copied.splats):,} splats are the slots of {len(state.model):,} anchors"


def unfold_splats(
    source: Path,
    out: Path,
    settings: Mapping[str, Any],
    observer: Observer,
    options: RunOptions,
    teaching: Teaching,
) -> Report | None:
    """Train levels of finished splats in a folder, or go on with what is there.

    Args:
        source: A PLY, compressed PLY, SPZ, SOG, GLB or .splat file, or a `lod-meta.json`.
        out: Folder of the run.
        settings: Settings by dotted name; they always win.
        observer: Hears of everything.
        options: Renderer, evaluation, limits.
        teaching: Renders to train on.

    Returns:
        The report, if one was ordered.

    Raises:
        InputError: the source holds no Gaussians that can be used, or no camera sees them.
        SettingError: the folder is a run of something else, or a setting cannot be.
        SceneError: the scene of photos cannot be read.
        SpaceError: not enough disk or memory.
    """
    teacher_recipe(0, 1, 0.0, settings)  # refuses before anything is read
    known = known_cameras(source, teaching.cameras)
    photographed = None if teaching.scene is None else load_scene(teaching.scene)
    given = without_coarse(usable(read_splats(source), source))
    release_freed()
    for note in given.notes:
        observer.on_message(note)
    if line := memory_line(given):
        observer.on_message(f"{line} until training begins")
    taken = take_device(options.device)
    photos = photographed and ScenePhotos(photographed, teaching.width, given.shift)
    if photos is not None:
        for note in (*photos.scene.notes, photos.scene.account.text()):
            observer.on_message(note)
        if teaching.cameras is None:
            cameras = [moved(c, np.array(given.shift)) for c in photos.cameras(photos.scene.train)]
            known = replace(known, sources=((photos.scene.root, cameras),), asked=True)
    renderer = fresh(taken.renderer)
    copied = prepare(given, source, out, teaching, known, photos, renderer, observer)
    scene = load_scene(out / RENDERS)
    recipe = teacher_recipe(len(copied.splats), len(scene.train), copied.voxel, settings)
    start = FromSplats(copied)
    del given, copied, renderer
    release_freed()
    context = make_context(scene, recipe.config, options, taken=taken)
    context = replace(context, alpha=RenderedAlpha(scene))
    tell_plan(observer, context, recipe)
    return train_run(context, recipe, out, start, options, observer)


def usable(given: SplatFile, source: Path) -> SplatFile:
    """The input, if there is something to train on.

    Raises:
        InputError: there are too few splats, or none that is opaque.
    """
    finest = given.levels[-1]
    if len(finest) < FEWEST:
        advice = "so few need no levels: gsynopsis import makes a file of them"
        raise InputError(
            source,
            "splats",
            found=f"{len(finest):,}",
            expected=f"at least {FEWEST}",
            advice=advice,
        )
    return given


def prepare(  # noqa: PLR0913 -- all that was read, and who renders and hears
    given: SplatFile,
    source: Path,
    out: Path,
    teaching: Teaching,
    known: Known,
    photos: ScenePhotos | None,
    renderer: Renderer,
    observer: Observer,
) -> Copied:
    """Make the scene of renders, or find it made; what is to be copied.

    Raises:
        SettingError: the folder has renders of another input, or a run of photos.
        InputError: no camera sees something, or photos are of something else.
        SpaceError: the disk is full.
    """
    identity = identity_of(given, teaching, known)
    if photos is not None:
        identity["photos"] = photos.digest()
    if (out / RUN_FILE).exists() and not (out / RENDERS / TEACHER).exists():
        raise SettingError("--out", found=f"{out}: a run of photos", expected="another folder")
    folder = out / RENDERS
    refuse_link(folder)
    _check_identity(folder, identity)
    model = splat_model(given)
    model.to(renderer.device)
    if (folder / TRANSFORMS).exists():
        scene = load_scene(folder)
        cameras = [scene.camera(view) for view in scene.train if is_render(scene.views[view])]
        return what_to_copy(given, model, cameras, renderer, observer)
    found = chosen_views(given, source, known, teaching, renderer)
    if photos is not None:
        found = replace(found, lines=(*found.lines, photos.check_world(model, renderer)))
    for line in found.lines:
        observer.on_message(line)
    views = parts_of(found, teaching) if photos is None else parts_beside(found, teaching, photos)
    copied = what_to_copy(given, model, views["train"], fresh(renderer), observer)
    make_folder(out)
    inner_folder(out, RENDERS)
    publish(folder / TEACHER, json.dumps(identity, indent=1) + "\n")
    publish(sheet_path(out / SHEET_OF), sheet_of(model, found, renderer))
    pixels = {} if photos is None else photos.parts
    write_renders(model, views, pixels, folder, renderer, observer.on_pass)
    points = copied.clusters.lattice.astype(np.float64) * copied.voxel
    note = f"photos are renders of the input {source.name} on black, not of a camera"
    if photos is not None:
        name, count = photos.scene.name, len(photos.scene.train)
        note += f"; beside them {count} photos of {name} are trained on, held-out ones are its own"
    note = "; ".join([note, *found.lines])
    colors = colors_of(copied.splats, copied.clusters)
    write_scene(views, points, colors, folder, note, found.up)
    return copied


def identity_of(given: SplatFile, teaching: Teaching, known: Known) -> dict[str, Any]:
    """Identity of renders: the splats and how they are looked at."""
    finest, digest = given.levels[-1], hashlib.blake2b(digest_size=16)
    for values in (finest.means, finest.log_scales, finest.quaternions, finest.logits, finest.sh):
        digest.update(np.ascontiguousarray(values).tobytes())
    for _, cameras in known.sources:
        for camera in cameras:
            lens = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
            digest.update(np.array(lens).tobytes() + camera.w2c.tobytes())
    return {
        "splats": digest.hexdigest(),
        "antialiased": given.antialiased,
        "up": list(given.up if teaching.up is None else teaching.up),
        "views": teaching.views,
        "width": teaching.width,
        "held_out": teaching.held_out,
    }


def _check_identity(folder: Path, identity: Mapping[str, Any]) -> None:
    path = folder / TEACHER
    if not path.exists():
        return
    try:
        there = json.loads(read_regular(path, 1 << 16, links=False))
    except ValueError:
        there = None
    if there != identity:
        found = "renders of another input, or other views"
        raise SettingError("--out", found=f"{folder}: {found}", expected="another folder")


@one_torch_thread()
def chosen_views(
    given: SplatFile, source: Path, known: Known, teaching: Teaching, renderer: Renderer
) -> Viewpoints:
    """Cameras to render the input from.

    Raises:
        InputError: no camera sees enough, or those given see nothing.
    """
    count = teaching.views + 2 * teaching.held_out
    found = splat_views(given, source, known, teaching.up, count, teaching.width, renderer)
    if found.doubt or len(found.cameras) < FEWEST_VIEWS:
        reason = found.doubt or f"{len(found.cameras)} cameras"
        expected = f"a scene that at least {FEWEST_VIEWS} cameras see"
        raise InputError(source, found=reason, expected=expected, advice="give --cameras")
    return found


def parts_of(found: Viewpoints, teaching: Teaching) -> dict[str, list[Camera]]:
    """Cameras to train on, to choose settings by, and to report from.

    Those that nothing is trained on are spread evenly over all; of fewer cameras than were asked
    for they are as many fewer.
    """
    cameras = [camera.within(teaching.width) for camera in found.cameras]
    share = 2 * teaching.held_out / (teaching.views + 2 * teaching.held_out)
    held = min(2 * teaching.held_out, 2 * max(1, round(share * len(cameras) / 2)))
    rows = (np.arange(held) * 2 + 1) * len(cameras) // (2 * held)
    apart = set(rows.tolist())
    train = [camera for number, camera in enumerate(cameras) if number not in apart]
    val, test = ([cameras[row] for row in rows[side::2].tolist()] for side in (0, 1))
    return {"train": train, "val": val, "test": test}


def parts_beside(
    found: Viewpoints, teaching: Teaching, photos: ScenePhotos
) -> dict[str, list[Camera]]:
    """Cameras of photos, to train on and to report from, and of renders around given cameras.

    A render from a photo's own place would tell what the photo tells.
    """
    count, chance = teaching.views + teaching.held_out, np.random.default_rng(0)
    cameras = [camera.within(teaching.width) for camera in evenly(found.cameras, count)]
    scene = photos.scene
    near = [around(cameras[k % len(cameras)], scene.extent, chance) for k in range(count)]
    own = {"photos": photos.cameras(scene.train), "test": photos.cameras(scene.test)}
    return {"train": near[: teaching.views], "val": near[teaching.views :], **own}


@one_torch_thread()
def what_to_copy(
    given: SplatFile,
    model: SplatModel,
    cameras: list[Camera],
    renderer: Renderer,
    observer: Observer,
) -> Copied:
    """Splats that some of the cameras see, in clusters."""
    finest = given.levels[-1]
    some = cameras[:: max(1, len(cameras) // RANKING_VIEWS)]
    worth = worth_of(model, shown(finest), some, renderer, observer.on_pass)
    rows = np.flatnonzero(worth > SHOWING * worth.max())
    splats, worth = rows_of(finest, rows), worth[rows]
    points = splats.means.astype(np.float64)
    label, count = clustered(points, PER_ANCHOR)
    voxel = lattice_cell(points, label, count)
    clusters = clusters_of(points, worth, label, count, voxel, PER_ANCHOR)
    copied = int((clusters.members >= 0).sum())
    if copied < len(finest):
        unseen = len(finest) - len(rows)
        observer.on_message(
            f"{copied:,} of {len(finest):,} splats are copied: {unseen:,} show in no render"
        )
    return Copied(splats, worth, clusters, voxel)


@one_torch_thread()
def begun_state(context: TrainContext, copied: Copied) -> TrainState:
    """A training before its first step, whose model is about what it copies."""
    seed, config = context.config.train.seed, context.config.model
    generator = torch.Generator().manual_seed(seed)
    frame = make_frame(context.scene, config)
    model = fitted_model(copied.splats, copied.clusters, copied.weights, frame, config, generator)
    return new_state(context, model, generator, np.random.default_rng(seed))
