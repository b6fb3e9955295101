"""COLMAP sparse models on disk → a `SceneRecords`.

Rigs and frames (rigs.bin, frames.bin, COLMAP 3.12 and later) repeat what images.bin says and are
not read. Observations are checked for length and passed over. Points come from
points3D.bin or points3D.txt, or where these are missing or empty from points3D.ply.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gsynopsis.errors import SceneError
from gsynopsis.scene.account import Account, listed
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.colmap.binary import read_binary
from gsynopsis.scene.colmap.model import (
    Pose,
    SparseModel,
    poses_advice,
    rotation_from_quaternion,
)
from gsynopsis.scene.colmap.text import read_text
from gsynopsis.scene.ply import read_ply
from gsynopsis.scene.search import (
    MODEL_FILES,
    PhotoIndex,
    find_models,
    photo_folders,
    unused_files,
)
from gsynopsis.scene.views import LOST, MISSING, UNPOSED, SceneRecords, View, place_of, views_of

POINTS = "points3D.ply"
FRAMED = 0.75
"""Least share of observations whose point lies in its photo's frame; real models have 0.99."""


def find_sparse(root: Path) -> Path | None:
    """The first folder of a sparse model, see `search.find_models`; None if there is none."""
    return next(iter(find_models(root)), None)


def read_sparse(folder: Path) -> SparseModel:
    """The sparse model in `folder`, binary if it holds cameras or images so, else text.

    Raises:
        SceneError: A file is missing, unreadable, truncated or holds what cannot be.
    """
    model = _read_posed(folder)
    if not len(model.points) and (folder / POINTS).is_file():
        points, colors = read_ply(folder / POINTS)
        return replace(model, points=points, colors=colors)
    return model


def _read_posed(folder: Path, *, points: bool = True) -> SparseModel:
    kind = _kind(folder)
    for name in MODEL_FILES[:2]:
        path = folder / f"{name}.{kind}"
        if not path.is_file():
            advice = "a sparse model is cameras, images and points3D, all .bin or all .txt"
            raise SceneError(path, found="no such file", expected="COLMAP's file", advice=advice)
    return read_binary(folder, points) if kind == "bin" else read_text(folder, points)


def _kind(folder: Path) -> str:
    """The layout that has both cameras and images; where none has, that of any file."""
    for wanted in (MODEL_FILES[:2], MODEL_FILES[:1], MODEL_FILES[1:]):
        for kind in ("bin", "txt"):
            there = [(folder / f"{name}.{kind}").is_file() for name in wanted]
            if all(there) if wanted == MODEL_FILES[:2] else any(there):
                return kind
    return "bin"


@dataclass(frozen=True)
class PlacedModel:
    """A model and the folder of its photos.

    Attributes:
        folder: Folder of the model.
        photos: The folder with most of its photos.
        found: Number of its photos there.
        images: Number of its images.
        error: Reason why it cannot be read; None if it can.
    """

    folder: Path
    photos: Path
    found: int = 0
    images: int = 0
    error: SceneError | None = None


def best_model(root: Path, models: Sequence[Path], photos: Path | None = None) -> list[PlacedModel]:
    """The models, that with most photos on disk first; of equal ones the first.

    Args:
        root: The scene's folder.
        models: Folders in it, not empty.
        photos: Where the photos lie; None: where most of them are.
    """
    alone = len(models) == 1
    placed = [_placed(root, folder, photos, alone=alone) for folder in models]
    return sorted(placed, key=lambda p: (p.error is not None, -p.found, -p.images))


def not_read(root: Path, others: Sequence[PlacedModel], advice: str) -> tuple[str, ...]:
    """A phrase on the models of a scene that are not read; empty where all are.

    Args:
        root: The scene's folder.
        others: The models.
        advice: What makes one of them read.
    """
    names: list[str] = []
    for other in others:
        why = f" with {other.found} photos" if other.images else ""
        name = name_of(root, other.folder)
        names.append(f"{name}, damaged" if other.error else f"{name}{why}")
    if not names:
        return ()
    known = "another model is" if len(names) == 1 else f"{len(names)} other models are"
    return (f"{known} not read ({listed(names)}): to use one, {advice}",)


def name_of(root: Path, model: Path) -> str:
    """A model's folder as seen from the scene's, for messages."""
    if model == root:
        return "the model in the folder itself"
    return model.relative_to(root).as_posix() if model.is_relative_to(root) else str(model)


def _placed(root: Path, folder: Path, photos: Path | None, *, alone: bool) -> PlacedModel:
    likely = photo_folders(root, folder) if photos is None else [photos]
    if alone and len(likely) == 1:
        return PlacedModel(folder, likely[0])
    try:
        model = _read_posed(folder, points=False)
        names = [place_of(folder, Path(), image.name) for image in model.images]
    except SceneError as error:
        return PlacedModel(folder, likely[0], error=error)
    finders = [PhotoIndex(place) for place in likely]
    counts = [sum(f.find(f.folder / name).is_file() for name in names) for f in finders]
    best = counts.index(max(counts))
    return PlacedModel(folder, likely[best], counts[best], len(names))


def read_colmap(root: Path, sparse: Path, images: Path | None = None) -> SceneRecords:
    """The scene of a sparse model whose photos lie in `images`, `root/images` if None.

    Images without a pose or a file are left out.

    Raises:
        SceneError: As `read_sparse`; there is no folder of images; or an image names no camera
            or leads out of its folder.
    """
    model = read_sparse(sparse)
    folder = root / "images" if images is None else images
    if not folder.is_dir():
        raise SceneError(folder, found="no such folder", expected="the scene's photos")
    path, photographs = sparse / f"images.{_kind(sparse)}", PhotoIndex(folder)

    def photo(name: str) -> Path:
        return photographs.find(place_of(path, folder, name))

    found = [(image, photo(image.name)) for image in model.images]
    there = [(image, file) for image, file in found if file.is_file()]
    made = [(image.number, _views(path, model, image, file)) for image, file in there]
    views = tuple(view for _, own in made for view in own)
    missing = [image.name for image, file in found if not file.is_file()]
    known = {*(view.path for view in views), *map(photo, model.lost)}
    rest = unused_files(root, [folder], known, folder)
    account = Account(source=name_of(root, sparse), unread=rest.endings)
    account = account.without(LOST, model.lost).without(MISSING, missing)
    account = account.without(UNPOSED, rest.photos)
    cameras = {number: own[0].camera for number, own in made if len(own) == 1}
    notes = (*model.notes, *photographs.notes, *_track_notes(root, account.source, model, cameras))
    return SceneRecords(path, views, model.points, model.colors, notes=notes, account=account)


def _track_notes(
    root: Path, source: str, model: SparseModel, cameras: Mapping[int, Camera]
) -> tuple[str, ...]:
    """A sentence on photos that do not show what their model says, by the cameras of their numbers.

    So it is where a script wrote other poses, or took the points of another model.
    """
    order = np.argsort(model.tracks.images, kind="stable")
    numbers, starts = np.unique(model.tracks.images[order], return_index=True)
    count = framed = 0
    for number, rows in zip(numbers.tolist(), np.split(order, starts[1:]), strict=False):
        if camera := cameras.get(number):
            count += len(rows)
            points = model.points[model.tracks.points[rows]]
            framed += int(camera.framed(points).which.sum())
    if framed >= FRAMED * count:
        return ()
    return (
        f"{1 - framed / count:.0%} of what {source} says photos show lies outside of them: its "
        f"poses and points are not of one model, and levels will be blurred; {poses_advice(root)}",
    )


def _views(path: Path, model: SparseModel, image: Pose, place: Path) -> tuple[View, ...]:
    if image.camera not in model.cameras:
        wanted = f"a camera of {path.with_stem('cameras').name}"
        raise SceneError(path, f"image {image.name} camera", found=image.camera, expected=wanted)
    w2c = np.eye(4)
    w2c[:3, :3] = rotation_from_quaternion(image.quaternion)
    w2c[:3, 3] = image.translation
    field, cameras = f"camera {image.camera}", path.with_stem("cameras")
    return views_of(cameras, field, (image.name, place), model.cameras[image.camera], w2c)
