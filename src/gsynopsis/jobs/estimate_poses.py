"""Photos or a video to a scene: poses and points by structure from motion, distortion taken out.

Each step leaves its result in OUT/sfm, so an interrupted run goes on where it stopped; the folder
is removed when the scene is whole.
"""

import json
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from gsynopsis.capture.masks import gathered_with_masks
from gsynopsis.capture.matching import Matching, resolve_matching
from gsynopsis.capture.photo_set import PhotoSet, digest_of, gather, prepare, with_cuts
from gsynopsis.capture.sfm import (
    FEATURES,
    OVERLAP,
    LensModel,
    Mapper,
    Reconstructed,
    find_features,
    load_pycolmap,
    map_photos,
    match_features,
    set_upright,
    sources_of,
    summary_of,
    undistort,
    warps_of,
)
from gsynopsis.capture.video import FRAMES, check_video, is_video, take_frames
from gsynopsis.errors import InputError, SettingError
from gsynopsis.evaluation.formatting import count, duration
from gsynopsis.files import DRAFT, publish, published, refuse_link
from gsynopsis.runs.folder import make_folder
from gsynopsis.runs.lock import run_lock
from gsynopsis.scene.account import ESTIMATED, Account, listed
from gsynopsis.scene.camera import Camera, positions_of
from gsynopsis.scene.colmap.distortion import Warp
from gsynopsis.scene.colmap.read import find_sparse
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.masks import warp_masks
from gsynopsis.scene.other_poses import models_above, other_poses
from gsynopsis.scene.programs.find import find_program
from gsynopsis.scene.scene import Scene
from gsynopsis.scene.search import find_models, photo_folder, unread_folders
from gsynopsis.scene.spheres import Cut
from gsynopsis.scene.transforms import find_transforms
from gsynopsis.training.observer import Observer, Silent

UNPLACED = "not placed"
"""Reason for which a photo has no pose."""
WORK, FRAMES_FOLDER = "sfm", "frames"
POSED = "scene"
"""Folder in a run's for the scene that was made of photos alone."""
REPORT_FILE, PICTURE_FILE, STATE_FILE = ESTIMATED, "scene.png", "state.json"
GOOD_SHARE = 0.9
"""Share of the photos below which the report says what to try."""
GOOD_ERROR = 1.5
"""Mean reprojection error above which it does, pixels."""
PICTURE = 640
"""Side of each of the two views in the picture, pixels."""
PICTURED = 0.9
"""Share of points and cameras, from the middle, that the picture has room for."""


@dataclass(frozen=True)
class PoseOptions:
    """Options of the estimation of poses.

    Attributes:
        matching: Which photos are compared with which.
        mapper: `auto` tries the global one first.
        lens: Camera model to estimate.
        features: Most keypoints of a photo.
        up: Direction away from the ground in the finished scene's axes before it is turned
            upright; None: from the photos.
        frames: Most photos taken from a video.
        alpha: Alpha channels of photos are their masks.
    """

    matching: Matching = "auto"
    mapper: Mapper = "auto"
    lens: LensModel = "OPENCV"
    features: int = FEATURES
    up: tuple[float, float, float] | None = None
    frames: int = FRAMES
    alpha: bool = False


@dataclass(frozen=True)
class PoseReport:
    """A scene that was made of photos.

    Attributes:
        scene: Its folder.
        photos: Photos of use in the source folder.
        found: What structure from motion found out.
        matching: How photos were compared.
        seconds: Wall time by step; of an interrupted step only its last run.
        notes: What to know, a sentence each.
        account: Which of the photos were placed, and what in their folder was passed over.
    """

    scene: Path
    photos: int
    found: Reconstructed
    matching: str
    seconds: dict[str, float]
    notes: tuple[str, ...]
    account: Account = field(default_factory=Account)

    def text(self) -> str:
        """The report as lines."""
        found = self.found
        spent = ", ".join(f"{step} {duration(time)}" for step, time in self.seconds.items())
        lines = [
            f"{len(found.registered)} of {self.photos} photos placed by {found.mapper} mapping, "
            f"{count(found.points)} points, each in {found.observations:.1f} photos, "
            f"mean reprojection error {found.error:.2f} px",
            *(f"camera: {camera}" for camera in found.cameras),
            f"time: {spent}",
            *self.notes,
            self.account.text(),
            f"wrote {self.scene} ({REPORT_FILE}, {PICTURE_FILE}: cameras and points)",
        ]
        return "\n".join(lines)

    def document(self) -> dict[str, object]:
        """The report as plain values: what `scene.json` holds."""
        values: dict[str, object] = asdict(self)
        return values | {"scene": self.scene.name}


def pose_for(photos: Path, out: Path, observer: Observer, *, alpha: bool = False) -> None:
    """Make the scene that a run in `out` trains on, of photos alone, and say so.

    Args:
        photos: Their folder, or a video.
        out: Folder of the run.
        observer: Told of steps and progress.
        alpha: Alpha channels of photos are their masks.

    Raises:
        InputError: see `estimate_poses`.
    """
    scene = out / POSED
    held = "is a video" if is_video(photos) else "holds photos without poses"
    observer.on_message(f"{photos} {held}: estimating poses into {scene}")
    options = PoseOptions(alpha=alpha)
    observer.on_message(estimate_poses(photos, scene, options, observer).text())


def estimate_poses(
    photos: Path, out: Path, options: PoseOptions | None = None, observer: Observer | None = None
) -> PoseReport:
    """Make a scene of photos alone, or go on with one that was interrupted.

    Args:
        photos: Their folder, or one with `images/` in it, or a video.
        out: Folder of the scene, made if it is missing; not the photos' own.
        options: How.
        observer: Told of steps and progress.

    Raises:
        SceneError: the photos are of no use or do not fit together; the message says what to try.
        SettingError: `out` holds something else, or another process works in it.
        MissingExtraError: pycolmap is not installed.
    """
    options, told = options or PoseOptions(), observer or Silent()
    if is_video(photos):
        return _of_video(photos, out, options, told)
    load_pycolmap()
    _check_places(photos, out)
    gathered = _with_beside(photos, _gathered(photo_folder(photos), told), told)
    gathered = with_cuts(gathered_with_masks(photos, gathered, alpha=options.alpha))
    make_folder(out)
    with run_lock(out):
        work = _Work(gathered.digest, out, options, told)
        return work.finished() or work.run(gathered)


def _of_video(video: Path, out: Path, options: PoseOptions, told: Observer) -> PoseReport:
    """As `estimate_poses`, of frames that are kept beside the work until the scene is whole."""
    check_video(video)
    load_pycolmap()
    _check_places(video, out)
    digest, new, frames = digest_of(video), not out.exists(), out / FRAMES_FOLDER
    make_folder(out)
    try:
        with run_lock(out):
            work = _Work(digest, out, options, told)
            if report := work.finished():
                return report
            tick = partial(told.on_pass, "looking at frames")
            note = take_frames(video, digest, frames, options.frames, tick)
            told.on_message(note)
            gathered = _gathered(frames, told, filmed=True)
            report = work.run(with_cuts(replace(gathered, taken=note)))
            shutil.rmtree(frames)
            return report
    finally:
        if new and not any(out.iterdir()):
            out.rmdir()


def _gathered(folder: Path, told: Observer, *, filmed: bool = False) -> PhotoSet:
    tick = partial(told.on_pass, "opening photos")
    gathered = gather(folder, tick, filmed=filmed)
    for note in gathered.notes:
        told.on_message(note)
    return gathered


def _with_beside(root: Path, gathered: PhotoSet, told: Observer) -> PhotoSet:
    """The photos with an account of the poses that lie beside them, which are said first."""
    models, unread = [*(find_models(root) or find_transforms(root))], tuple[str, ...]()
    if not models:
        placed, unread = find_program(root)
        models = [] if placed is None else [placed.path]
    names = listed([path.relative_to(root).as_posix() for path in models])
    ours = (f"poses are there already ({names}): train {root} reads them",) if models else ()
    others = other_poses(root, gathered.folder, read=True)
    beside = (*ours, *unread, *others, *models_above(root))
    for phrase in beside:
        told.on_message(f"estimating poses anew: {phrase}")
    read = [photo.path for photo in gathered.photos]
    beside += unread_folders(root, [*read, *gathered.masks.values()])
    return replace(gathered, account=gathered.account.with_unread_models(*beside))


class _Work:
    """One estimation in its folder."""

    def __init__(self, source: str, out: Path, options: PoseOptions, observer: Observer) -> None:
        """Work folder of photos or a video with this digest."""
        self.out, self.options, self.told = out, options, observer
        self.folder = out / WORK
        self.photos, self.database = self.folder / "photos", self.folder / "database.db"
        self.done: list[str] = []
        self.seconds: dict[str, float] = {}
        self.mapper = ""
        asked = {"photos": source, **asdict(options)}
        self.asked: dict[str, Any] = json.loads(json.dumps(asked))

    def run(self, gathered: PhotoSet) -> PoseReport:
        """All steps that are left, then the report."""
        self._open()
        names = [photo.name for photo in gathered.photos]
        matching = resolve_matching(sources_of(gathered.photos), self.options.matching)
        opts, work = self.options, self.folder
        self._step("photos", lambda: prepare(gathered, self.photos))
        tick = self._tick("finding keypoints")
        self._step(
            "keypoints",
            lambda: find_features(
                gathered, self.photos, self.database, opts.lens, tick, opts.features
            ),
        )
        self.told.on_message(f"matching: {matching}, {len(names)} photos")
        pairs = self._tick("matching pairs")
        self._step("matches", lambda: match_features(gathered, self.database, matching, pairs))
        self._step("mapping", lambda: self._map(gathered))
        self._step("upright", lambda: set_upright(work / "model", opts.up))
        self._step("undistortion", lambda: undistort(self.photos, work / "model", self.out))
        if gathered.masks:
            self._step("masks", lambda: self._warp_masks(gathered))
        report = self._report(gathered, matching)
        shutil.rmtree(work)
        return report

    def finished(self) -> PoseReport | None:
        """The report of the same work if it was done before; what that left is removed."""
        path = self.out / REPORT_FILE
        if not path.is_file() or find_sparse(self.out) is None:
            return None
        try:
            values = json.loads(path.read_text("utf-8"))
            if values.pop("asked") != self.asked:
                return None
            values["found"] = msgspec.convert(values["found"], Reconstructed)
            values["account"] = msgspec.convert(values.get("account", {}), Account)
            report = PoseReport(**values | {"scene": self.out, "notes": tuple(values["notes"])})
        except (ValueError, KeyError, TypeError, AttributeError, msgspec.ValidationError):
            return None
        # Left where it was stopped between the report and their removal.
        for left in (self.folder, self.out / FRAMES_FOLDER):
            shutil.rmtree(left, ignore_errors=True)
        return report

    def _open(self) -> None:
        """Go on with what is there if it is of the same photos and options."""
        refuse_link(self.folder)
        path = self.folder / STATE_FILE
        if path.is_file():
            try:
                state = json.loads(path.read_text("utf-8"))
            except ValueError:
                state = {}
            if state.get("asked") == self.asked:
                self.done, self.seconds = state["done"], state["seconds"]
                self.mapper = state["mapper"]
                self.told.on_message(f"going on with {self.folder}")
                return
            self.told.on_message("other photos or options than before: beginning again")
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        self._save()

    def _step(self, name: str, work: Callable[[], object]) -> None:
        if name in self.done:
            return
        started = time.monotonic()
        work()
        self.seconds[name] = round(time.monotonic() - started, 1)
        self.done.append(name)
        self._save()
        if self.seconds[name] >= 2:
            self.told.on_message(f"{name}: {duration(self.seconds[name])}")

    def _map(self, gathered: PhotoSet) -> None:
        self.told.on_message("mapping: poses of all photos together, about as long as matching")
        self.mapper = map_photos(
            gathered, self.photos, self.database, self.folder / "model", self.options.mapper
        )

    def _warp_masks(self, gathered: PhotoSet) -> None:
        sources = {photo.name: photo.path for photo in gathered.photos}
        warps: dict[str, Warp | Cut] = {}
        warps |= warps_of(self.folder / "model", self.out / "sparse" / "0")
        cut = {photo.name: photo.cut for photo in gathered.photos if photo.cut is not None}
        warps |= {name: cut[name] for name in cut.keys() & warps.keys()}
        own = {photo.name for photo in gathered.photos}
        own = {name for name in own if gathered.masks.get(name) == sources[name]}
        warp_masks(gathered.masks, warps, self.out / "masks", own)

    def _save(self) -> None:
        state = {name: getattr(self, name) for name in ("asked", "done", "seconds", "mapper")}
        publish(self.folder / STATE_FILE, json.dumps(state))

    def _tick(self, what: str) -> Callable[[int, int], None]:
        return lambda done, total: self.told.on_pass(what, done, total)

    def _report(self, gathered: PhotoSet, matching: str) -> PoseReport:
        names = [photo.name for photo in gathered.photos]
        found = summary_of(self.folder / "model", names, self.mapper)
        notes = (*gathered.notes, *advice_of(found, len(names)))
        account = replace(gathered.account, photos=len(found.registered))
        account = account.without(UNPLACED, found.missing)
        report = PoseReport(self.out, len(names), found, matching, self.seconds, notes, account)
        scene = load_scene(self.out, "none")
        with published(self.out / PICTURE_FILE) as draft:
            picture_of(scene).save(draft)
        document = report.document() | {"asked": self.asked}
        publish(self.out / REPORT_FILE, json.dumps(document, indent=1) + "\n")
        return report


def advice_of(found: Reconstructed, photos: int) -> list[str]:
    """Advice where the result is poor; empty if it is not."""
    lines: list[str] = []
    if found.missing:
        more = f" and {len(found.missing) - 3} more" if len(found.missing) > 3 else ""
        lines.append(f"not placed: {', '.join(found.missing[:3])}{more}")
    if len(found.registered) < GOOD_SHARE * photos:
        lines.append(
            f"to place more: {OVERLAP}; or try --matching exhaustive, --mapper incremental"
        )
    if found.error > GOOD_ERROR:
        lines.append(
            "the reprojection error is large: photos may be blurred, or of several zooms; "
            "try --lens SIMPLE_RADIAL, or OPENCV_FISHEYE for a fisheye lens"
        )
    return lines


def picture_of(scene: Scene) -> Image.Image:
    """Points and cameras from above and from the side; z is up."""
    cameras = [view.camera for view in scene.views]
    places = positions_of(cameras)
    middle = np.median(places, axis=0)
    away = np.abs(np.concatenate([scene.points, places]) - middle).max(axis=1)
    reach = 1.1 * max(float(np.quantile(away, PICTURED)), 1e-12)
    sheet = Image.new("RGB", (2 * PICTURE, PICTURE), "white")
    draw = ImageDraw.Draw(sheet)
    for left, axes, name in ((0, (0, 1), "from above"), (PICTURE, (0, 2), "from the side")):
        spot = partial(_spot, middle=middle, axes=axes, reach=reach, left=left)
        flat = spot(scene.points)
        inside = ((flat >= (left, 0)) & (flat < (left + PICTURE, PICTURE))).all(axis=1)
        for (x, y), color in zip(flat[inside], scene.colors[inside].tolist(), strict=True):
            draw.point((float(x), float(y)), fill=tuple(color))
        _draw_cameras(draw, cameras, spot, reach)
        draw.text((left + 8, 8), name, fill="black")
    draw.line((PICTURE, 0, PICTURE, PICTURE), fill="grey")
    return sheet


def _spot(
    points: NDArray[np.float64],
    *,
    middle: NDArray[np.float64],
    axes: tuple[int, int],
    reach: float,
    left: int,
) -> NDArray[np.float64]:
    """Positions [P, 2] of points [P, 3] in the image along two axes, pixels."""
    flat = (points - middle)[:, list(axes)] / reach
    return (flat * (1, -1) + 1) * PICTURE / 2 + (left, 0)


def _draw_cameras(
    draw: ImageDraw.ImageDraw,
    cameras: Sequence[Camera],
    spot: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    reach: float,
) -> None:
    for camera in cameras:
        ends = np.stack([camera.position, camera.position + 0.06 * reach * camera.forward])
        (x, y), (u, v) = spot(ends).tolist()
        draw.line((x, y, u, v), fill="red")
        draw.ellipse((x - 2, y - 2, x + 2, y + 2), fill="red")


def _check_places(photos: Path, out: Path) -> None:
    """Refuses to write where photos lie, or into a folder that holds something else.

    Raises:
        SettingError: it is such a folder.
    """
    source, target = photos.resolve(), out.resolve()
    if target in {source, (source / "images").resolve()} or source.is_relative_to(target):
        raise SettingError(out, found="the folder of the photos", expected="another folder")
    if not out.exists():
        return
    if not out.is_dir():
        raise InputError(out, found="a file", expected="a folder to write to")
    frames = {FRAMES_FOLDER, f".{FRAMES_FOLDER}"}
    work = {WORK, REPORT_FILE, *frames}
    ours = work | {PICTURE_FILE, "images", "sparse", "masks", "training.lock"}
    # A kill may leave a draft, which goes when the file is written.
    names = {path.name for path in out.iterdir() if not DRAFT.fullmatch(path.name)}
    if names and not (names <= ours and names & work):
        raise SettingError(
            out,
            found="a folder with other files",
            expected="a new or empty folder, or an interrupted or earlier scene",
            advice="choose another folder",
        )
