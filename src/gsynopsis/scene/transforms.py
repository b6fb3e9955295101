"""transforms.json, in the forms of Blender's data sets and of nerfstudio → a `SceneRecords`.

Matrices are camera to world with OpenGL axes (x right, y up, z backward); the world's axes stay
as they are. Blender: `camera_angle_x`, names without extension, sizes from the photos, and
transforms_train.json with transforms_test.json in place of one file. nerfstudio: `fl_x`, `fl_y`,
`cx`, `cy`, `w`, `h` for all frames or each, and `ply_file_path`.
"""

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import SceneError
from gsynopsis.files import read_regular
from gsynopsis.scene.account import Account, listed
from gsynopsis.scene.camera import Camera, nearest_rotation, world_to_camera
from gsynopsis.scene.colmap.distortion import STRAIGHT, Lens
from gsynopsis.scene.colmap.model import (
    LARGEST,
    LARGEST_SIDE,
    NO_POINTS,
    Pinhole,
    panorama,
    undistort_advice,
)
from gsynopsis.scene.listed_photos import ListedPhotos
from gsynopsis.scene.panoramas import CUT_POSED
from gsynopsis.scene.ply import read_ply
from gsynopsis.scene.search import PhotoIndex, unused_files
from gsynopsis.scene.splits import SplitLists
from gsynopsis.scene.stored import read_header
from gsynopsis.scene.views import (
    LOST,
    MISSING,
    UNPOSED,
    SceneRecords,
    View,
    photo_name,
    place_of,
    views_of,
)

NOTE = "gsynopsis_note"
"""Field of ours: a sentence for `Scene.notes`, as that photos are renders."""
UP = "gsynopsis_up"
"""Field of ours: away from the ground, three numbers, where more than the cameras tell it."""
NO_DISTORTION = ("s1", "s2", "s3", "s4")
"""Thin prism terms, which no writer of these files estimates."""
PERSPECTIVE = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE", "SIMPLE_RADIAL", "RADIAL")
"""Values of `camera_model` for k1, k2, k3, p1, p2 as OpenCV has them."""
SPHERES = ("EQUIRECTANGULAR", "SPHERICAL")
"""Those of panoramas of the whole sphere."""
FISHEYE = ("OPENCV_FISHEYE", "FISHEYE")
"""Those for k1 to k4 of angles."""
RATIONAL = "FULL_OPENCV"
"""That for k1 to k6, the last three below the fraction."""
PARTS = ("transforms_train.json", "transforms_test.json", "transforms_val.json")
"""Blender's files, in the order of `SplitLists`."""
LISTS = ("train_filenames", "test_filenames", "val_filenames")
"""nerfstudio's lists, in that order."""
ALL_AROUND = re.compile(r"equirect|spheric|panoram|omnidirect|cylindr|latlong|360|vr180", re.I)
"""In the names of camera models that are no perspective lenses."""
MOST_BYTES = 1 << 26
"""Most bytes of a transforms.json: 100,000 frames have half; in memory JSON is ten times that."""
UNSAID = 800
"""Pixels of a side that is not in the file, as in Blender's data sets."""
SMALLEST = 1e-6
"""Least scale of a rotation that is taken out of it."""
RIGID_TOLERANCE = 1e-3
"""Largest distance of RᵀR from the identity in any element; it is then brought to a rotation."""


@dataclass(frozen=True)
class _Table:
    """A JSON object; a number that it lacks is looked up in its parent."""

    path: Path
    label: str
    values: dict[str, Any]
    parent: "_Table | None" = None

    def find(self, key: str) -> object:
        if key in self.values or self.parent is None:
            return self.values.get(key)
        return self.parent.find(key)

    def number(self, key: str) -> float | None:
        value = self.find(key)
        if value is None:
            return None
        if type(value) not in {int, float} or not abs(cast(float, value)) < LARGEST:
            raise self.bad(key, value, "a finite number")
        return float(cast(float, value))

    def text(self, key: str) -> str:
        value = self.find(key)
        if not isinstance(value, str):
            raise self.bad(key, value, "a text")
        return value

    def texts(self, key: str) -> list[str]:
        value = self.find(key)
        try:
            return msgspec.convert(value, list[str])
        except msgspec.ValidationError as error:
            raise self.bad(key, value, "a list of texts") from error

    def direction(self, key: str) -> tuple[float, float, float] | None:
        value = self.find(key)
        if value is None:
            return None
        try:
            found = msgspec.convert(value, tuple[float, float, float])
        except msgspec.ValidationError as error:
            raise self.bad(key, value, "three numbers") from error
        if not all(map(math.isfinite, found)) or not any(found):
            raise self.bad(key, value, "three numbers, not all 0")
        return found

    def bad(self, key: str, found: object, expected: str, advice: str = "") -> SceneError:
        field = f"{self.label}: {key}" if self.label else key
        return SceneError(
            self.path, field, found=repr(found)[:80], expected=expected, advice=advice
        )


def find_transforms(root: Path) -> tuple[Path, ...]:
    """The files that describe the scene: transforms.json, or Blender's for train and test."""
    if (root / "transforms.json").is_file():
        return (root / "transforms.json",)
    found = tuple(root / name for name in PARTS if (root / name).is_file())
    return found if found and found[0].name == PARTS[0] else ()


def read_transforms(root: Path, files: tuple[Path, ...]) -> SceneRecords:
    """The scene of a transforms.json, or of the two files for train and test.

    Frames without a finite pose or a photo are left out.

    Raises:
        SceneError: A file is not such JSON, has lens distortion, a pose that is not rigid, or
            names an image outside the scene; or its PLY file is damaged.
    """
    tables = [_load(path) for path in files]
    reader = _Frames(root, [frame for table in tables for frame in _frames(table)])
    parts = [reader.views(table) for table in tables]
    views, repeated = _once([view for part in parts for view in part])
    top, (points, colors) = tables[0], NO_POINTS
    lost = tuple[str, ...]()
    if top.values.get("ply_file_path") is not None:
        listing = place_of(top.path, root, top.text("ply_file_path"))
        if listing.exists():
            points, colors = read_ply(listing)
        else:
            lost = (f"{top.path.name}: ply_file_path {listing.name} is not on disk",)
    account = reader.account(files, views)
    if len(files) > 1:
        held = [frozenset(view.name for view in part) for part in parts]
        by_file = dict(zip([file.name for file in files], held, strict=True))
        names = [by_file.get(name, frozenset[str]()) for name in PARTS]
        lists = SplitLists(_parts_text([*by_file]), *names)
    else:
        lists, unknown = reader.lists(top, views)
        account = account.with_unread_models(*unknown)
    notes = (*lost, *reader.notes())
    if repeated:
        again = f"{len(repeated)} photos are listed twice ({listed(repeated)})"
        notes += (f"{again}: each is used once",)
    if top.values.get(NOTE) is not None:
        notes += (top.text(NOTE),)
    up = top.direction(UP)
    return SceneRecords(top.path, views, points, colors, lists, notes, account, up)


def read_poses(path: Path) -> list[Camera]:
    """The cameras of one file, whose photos need not be there, without lens distortion.

    Frames without a finite pose are left out. Where no size is said and there is no photo, the
    picture is a square of `UNSAID` pixels.

    Raises:
        SceneError: It is not such JSON, or has a pose that is not rigid.
    """
    out: list[Camera] = []
    for frame in _frames(_load(path)):
        w2c, _ = _world_to_camera(frame)
        if w2c is None or _is_sphere(frame):
            continue
        photo = path.parent / str(frame.values.get("file_path", ""))
        sized = frame.number("w") is not None or photo.is_file()
        own = _intrinsics(frame, photo if sized else None, STRAIGHT)
        out.append(Camera(own.width, own.height, own.fx, own.fy, own.cx, own.cy, w2c))
    return out


def _once(views: Sequence[View]) -> tuple[tuple[View, ...], list[str]]:
    """Views without those listed before with the same camera, and the names of these.

    Who has no photos to choose settings by lists those of the test twice.
    """
    first: dict[str, View] = {}
    kept, repeated = list[View](), list[str]()
    for view in views:
        known = first.setdefault(view.name, view)
        if known is not view and _same_camera(known.camera, view.camera):
            repeated.append(view.name)
        else:
            kept.append(view)
    return tuple(kept), repeated


def _same_camera(one: Camera, other: Camera) -> bool:
    lenses = [(c.width, c.height, c.fx, c.fy, c.cx, c.cy) for c in (one, other)]
    return lenses[0] == lenses[1] and bool((one.w2c == other.w2c).all())


def _parts_text(names: Sequence[str]) -> str:
    kinds = [Path(name).stem.removeprefix("transforms_") for name in names[1:]]
    return f"{PARTS[0]} and its {' and '.join(kinds)} file{'s'[: len(kinds) - 1]}"


def _load(path: Path) -> _Table:
    try:
        values = json.loads(read_regular(path, MOST_BYTES, SceneError))
    except (ValueError, RecursionError) as error:
        raise SceneError(path, found=str(error), expected="JSON") from error
    if not isinstance(values, dict):
        raise SceneError(path, found=type(values).__name__, expected="a JSON object")
    return _Table(path, "", cast(dict[str, Any], values))


def _frames(table: _Table) -> list[_Table]:
    frames = table.values.get("frames")
    if not isinstance(frames, list):
        raise table.bad("frames", frames, "a list")
    out: list[_Table] = []
    for number, frame in enumerate(cast(list[object], frames)):
        if not isinstance(frame, dict):
            raise table.bad(f"frame {number}", frame, "a JSON object")
        out.append(_Table(table.path, f"frame {number}", cast(dict[str, Any], frame), table))
    return out


class _Frames:
    """The frames of a scene: views, and the names of those that cannot be."""

    def __init__(self, root: Path, frames: Sequence[_Table]) -> None:
        self.root = root
        named = [str(frame.values.get("file_path", "")) for frame in frames]
        self.photographs, self.masks = ListedPhotos(root, named), PhotoIndex(root)
        self.lost: dict[str, list[str]] = {LOST: [], MISSING: []}
        self.seen: list[Path] = []
        self.scales: list[float] = []
        self.moments = set[float]()

    def views(self, table: _Table) -> tuple[View, ...]:
        return tuple(view for frame in _frames(table) for view in self._views(frame))

    def account(self, files: tuple[Path, ...], views: tuple[View, ...]) -> Account:
        tops = {self.root / view.path.relative_to(self.root).parts[0] for view in views}
        folders = [top if top.is_dir() else self.root for top in tops]
        rest = unused_files(self.root, folders, self.seen)
        account = Account(source=" and ".join(path.name for path in files), unread=rest.endings)
        for reason, names in self.lost.items():
            account = account.without(reason, names)
        return account.without(UNPOSED, rest.photos)

    def lists(
        self, top: _Table, views: tuple[View, ...]
    ) -> tuple[SplitLists | None, tuple[str, ...]]:
        """The lists that nerfstudio writes, if any, and a phrase on each with unknown names."""
        found, unknown = dict[str, frozenset[str]](), list[str]()
        known = {photo_name(v) for v in views}
        for key in LISTS:
            if top.values.get(key) is not None:
                names = frozenset(self._named(top, name) for name in top.texts(key))
                found[key] = frozenset(v.name for v in views if photo_name(v) in names)
                if names - known:
                    unknown.append(f"{key} has {len(names - known)} names of no photo in use")
        if not any(found.values()):
            return None, tuple(unknown)
        source = f"{' and '.join(found)} of {top.path.name}"
        train, test, val = (found.get(key) for key in LISTS)
        none = frozenset[str]()
        return SplitLists(source, train, test or none, val or none), tuple(unknown)

    def moment_notes(self) -> tuple[str, ...]:
        """A sentence on photos of several moments."""
        if len(self.moments) < 2:
            return ()
        return (
            f"photos of {len(self.moments)} moments (`time`): a scene stands still here, and what "
            "moves comes out blurred; take the frames of one moment",
        )

    def notes(self) -> tuple[str, ...]:
        """Sentences on oddities of the frames."""
        return (*self.photographs.notes, *self.scale_notes(), *self.moment_notes())

    def scale_notes(self) -> tuple[str, ...]:
        """A sentence on poses with a scale, which is taken out."""
        if not self.scales:
            return ()
        scale = f"{len(self.scales)} poses have a scale, the first {self.scales[0]:.4g}"
        return (f"{scale}: the rotation is what is left without it",)

    def _named(self, table: _Table, name: str) -> str:
        return self.photographs.path(table.path, name).relative_to(self.root).as_posix()

    def _views(self, frame: _Table) -> tuple[View, ...]:
        path = self.photographs.path(frame.path, frame.text("file_path"))
        self.seen.append(path)
        name = path.relative_to(self.root).as_posix()
        w2c, scale = _world_to_camera(frame)
        if abs(scale - 1) > RIGID_TOLERANCE:
            self.scales.append(scale)
        if (moment := _moment(frame)) is not None:
            self.moments.add(moment)
        sphere = _is_sphere(frame)
        lens = STRAIGHT if sphere else _lens(self.root, frame, path.parent)
        if w2c is None or not path.is_file():
            self.lost[LOST if w2c is None else MISSING].append(name)
            return ()
        own = panorama(*_size(frame, path)) if sphere else _intrinsics(frame, path, lens)
        views = views_of(frame.path, f"{frame.label}: camera", (name, path), own, w2c)
        if not frame.values.get("mask_path"):
            return views
        mask = self.masks.find(place_of(frame.path, self.root, frame.text("mask_path")))
        return tuple(replace(view, mask=mask) for view in views)


def _moment(frame: _Table) -> float | None:
    """The time at which a frame was taken, as Dynamic NeRF's data sets and nerfstudio have it."""
    for key in ("time", "timestamp", "cam_time"):
        value = frame.values.get(key)
        if type(value) in (int, float):
            return float(cast(float, value))
    return None


def _is_sphere(frame: _Table) -> bool:
    """True for a frame that is a panorama of the whole sphere."""
    model = frame.find("camera_model")
    return isinstance(model, str) and model.upper() in SPHERES


def _lens(root: Path, frame: _Table, folder: Path) -> Lens:
    """The lens of a frame, whose photo is in `folder`.

    Raises:
        SceneError: Its model or one of its terms is not known.
    """
    sparse = "colmap/sparse/0" if (root / "colmap" / "sparse" / "0").is_dir() else "sparse/0"
    images = folder if folder.is_dir() else root
    advice = undistort_advice(root, images.relative_to(root).as_posix(), sparse)
    model = frame.find("camera_model") or "OPENCV"
    if not isinstance(model, str) or model not in {*PERSPECTIVE, *FISHEYE, RATIONAL}:
        wanted = f"one of {', '.join([*PERSPECTIVE, *FISHEYE, RATIONAL])}"
        around = isinstance(model, str) and ALL_AROUND.search(model)
        raise frame.bad("camera_model", model, wanted, CUT_POSED if around else advice)
    k = tuple(frame.number(f"k{n}") or 0.0 for n in range(1, 7))
    p = (frame.number("p1") or 0.0, frame.number("p2") or 0.0)
    if frame.find("is_fisheye") or model in FISHEYE:
        return Lens(fisheye=True, radial=k[:4])
    for key in (*NO_DISTORTION, *(() if model == RATIONAL else ("k5", "k6"))):
        if frame.number(key):
            raise frame.bad(key, frame.number(key), f"0, or camera_model {RATIONAL}", advice)
    if model == RATIONAL:
        lens = Lens(radial=k[:3], divisor=k[3:], tangential=p)
    else:
        # Metashape's k4, as nerfstudio writes and reads it, is the factor of r⁸.
        lens = Lens(radial=k[:4], tangential=p)
    return STRAIGHT if lens.straight else lens


def _intrinsics(frame: _Table, path: Path | None, lens: Lens) -> Pinhole:
    width, height = _size(frame, path)
    fx = _focal(frame, "fl_x", "camera_angle_x", width)
    fy = _focal(frame, "fl_y", "camera_angle_y", height)
    if fx is None:
        raise frame.bad("fl_x", None, "fl_x or camera_angle_x")
    cx, cy = frame.number("cx"), frame.number("cy")
    middle = (width / 2 if cx is None else cx, height / 2 if cy is None else cy)
    return Pinhole(width, height, fx, fx if fy is None else fy, *middle, lens)


def _size(frame: _Table, path: Path | None) -> tuple[int, int]:
    """Image size in the file, else that of the photo."""
    wide, high = frame.number("w"), frame.number("h")
    if wide is None or high is None:
        return (UNSAID, UNSAID) if path is None else read_header(path).size
    for key, side in (("w", wide), ("h", high)):
        if side != int(side) or not 1 <= side <= LARGEST_SIDE:
            raise frame.bad(key, side, f"whole pixels, 1 to {LARGEST_SIDE}")
    return int(wide), int(high)


def _focal(frame: _Table, length: str, angle: str, side: int) -> float | None:
    """Focal length in pixels, from itself or from the angle of view over `side` pixels."""
    focal, view = frame.number(length), frame.number(angle)
    if focal is not None:
        if focal <= 0:
            raise frame.bad(length, focal, "a positive number")
        return focal
    if view is None:
        return None
    if not 0 < view < np.pi:
        raise frame.bad(angle, view, "an angle between 0 and π")
    return float(side / 2 / np.tan(view / 2))


def _world_to_camera(frame: _Table) -> tuple[NDArray[np.float64] | None, float]:
    """World to camera with OpenCV axes, float64 [4, 4], from the frame's OpenGL c2w; its scale.

    None if a number of it is not finite, as for a camera that was lost.
    """
    key = "transform_matrix"
    try:
        matrix = np.array(frame.values.get(key), np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise frame.bad(key, frame.values.get(key), "4 x 4 numbers") from error
    if matrix.shape not in {(4, 4), (3, 4)}:
        raise frame.bad(key, list(matrix.shape), "4 x 4 numbers")
    if not np.isfinite(matrix[:3]).all():
        return None, 1.0
    if not (np.abs(matrix) < LARGEST).all():
        raise frame.bad(key, "a number that is too large", f"finite numbers below {LARGEST:g}")
    rotation, position = matrix[:3, :3] * [1, -1, -1], matrix[:3, 3]
    # A camera's parent in Blender may be scaled, the same in all directions.
    scale = float(np.cbrt(np.abs(np.linalg.det(rotation))))
    rotation = rotation / scale if SMALLEST < scale < LARGEST else rotation
    nearest, off = nearest_rotation(rotation, RIGID_TOLERANCE)
    if nearest is None:
        raise frame.bad(key, f"RᵀR off by {off:.3g}", "a rigid pose (a rotation, no scale)")
    return world_to_camera(nearest, position), scale
