"""Reads a scene's folder: photos, poses and points → `Scene`."""

import os
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gsynopsis.errors import NoPosesError, SceneError
from gsynopsis.scene.account import estimated_account, listed
from gsynopsis.scene.camera import positions_of
from gsynopsis.scene.colmap.model import LARGEST, poses_advice
from gsynopsis.scene.colmap.read import PlacedModel, best_model, not_read, read_colmap
from gsynopsis.scene.masks import points_inside, with_masks
from gsynopsis.scene.other_poses import models_above, other_poses
from gsynopsis.scene.outliers import far_cameras, far_points
from gsynopsis.scene.photos import is_photo
from gsynopsis.scene.programs.find import find_program
from gsynopsis.scene.scene import DEFAULT_OPTIONS, Scene, SceneOptions
from gsynopsis.scene.search import (
    ORIGINALS,
    PHOTO_FOLDERS,
    count_photos,
    files_in,
    find_models,
    in_sparse,
    photo_folder,
    places_below,
    unread_folders,
)
from gsynopsis.scene.splits import Split, split_names
from gsynopsis.scene.transforms import find_transforms, read_transforms
from gsynopsis.scene.views import (
    UNPOSED,
    SceneRecords,
    View,
    check_listing,
    near_origin,
    parallax_notes,
    with_fallback_points,
)

MAP = re.compile("[_.](?:depth|normal)", re.I)
"""Beginning of what names of depth maps and normal maps have after their photo's."""


def load_scene(
    path: Path | str, split: Split = "every8", reading: SceneOptions | None = None
) -> Scene:
    """Reads a scene: a COLMAP model with `images/` beside it, or a transforms.json.

    All that can be checked without decoding pixels is checked here. Of several COLMAP models that
    with most photos is read. Where both are there, a model in `sparse` is read, else the
    transforms.json. Photos without a file or a finite pose are left out. `Scene.account` names
    what was left out and what was not read.

    Args:
        path: The scene's folder.
        split: Which views to hold out; files that say it themselves (Blender's) are followed
            instead, and a note says so.
        reading: What of the folder is read, and how.

    Raises:
        SceneError: Something in the folder is missing, damaged or not supported.

    Examples:
        >>> scene = gs.load_scene("scene")
        >>> [scene.views[view].name for view in scene.test]
        ['view_0000.png', 'view_0008.png']
    """
    path, reading = Path(path), reading or DEFAULT_OPTIONS
    try:
        found = path / reading.points if reading.points else None
        listing, shift = near_origin(with_fallback_points(_read(path, reading), found))
        listing = replace(listing, notes=listing.notes + check_listing(listing))
        listing = with_masks(path, listing, reading.masks)
        read = [file for view in listing.views for file in (view.path, view.mask) if file]
        others = unread_folders(path, read)
    except OSError as error:
        # Folders without permission, names too long for the file system.
        where = error.filename or path
        raise SceneError(where, found=error.strerror, expected="a readable scene") from error
    views = tuple(sorted(listing.views, key=lambda view: view.name))
    far = far_cameras(positions_of(view.camera for view in views))
    near = np.flatnonzero(~far).tolist()
    train, test, notes = _split(listing, views, near, split)
    if not train:
        raise SceneError(listing.path, "frames", found=0, expected="at least 1 view to train on")
    outside = tuple(view.name for view, out in zip(views, far, strict=True) if out)
    name, notes = path.resolve().name, listing.notes + _left_out(outside, len(views)) + notes
    scene = Scene(name, path, views, listing.points, listing.colors, train, test, notes, split)
    used = {*train, *test}
    unlisted = tuple(views[i].name for i in near if i not in used) if listing.lists else ()
    account = listing.account.with_unread_models(*others, *_advice_on_poses(path, listing))
    account = account.without("far outside of the others", outside)
    account = replace(
        account.without("of other split lists or none", unlisted),
        photos=len(used),
        split=listing.lists.source if listing.lists else f"rule {split}",
    )
    scene = _without_far_points(
        replace(
            scene,
            reading=reading,
            account=account,
            shift=shift,
            up=listing.up,
            random_points=listing.random_points,
        ),
        listing.path,
    )
    places = positions_of(views[view].camera for view in near)
    scene = replace(scene, notes=(*scene.notes, *parallax_notes(places, scene.points)))
    return _within_masks(scene) if reading.masks == "empty" and scene.masked else scene


def _advice_on_poses(root: Path, listing: SceneRecords) -> tuple[str, ...]:
    """A phrase where more photos lack a pose than have one: to estimate them all anew."""
    known = {view.path.stem for view in listing.views}
    bare = [
        name
        for name in listing.account.left_out.get(UNPOSED, ())
        if MAP.split(Path(name).stem)[0] not in known
    ]
    originals = root / ORIGINALS
    if len(bare) > len(listing.views):
        folder = Path(os.path.commonpath([view.path.parent.absolute() for view in listing.views]))
        inside = folder.parent == root.absolute() and folder.name in PHOTO_FOLDERS
        photos = root if inside else folder
    elif originals.is_dir() and sum(map(is_photo, files_in(originals))) > 2 * len(listing.views):
        photos = originals
    else:
        return ()
    return (f"most photos have no pose: gsynopsis scene {photos} NEW estimates those of all",)


def _within_masks(scene: Scene) -> Scene:
    """The scene without points outside the masks.

    Raises:
        SceneError: No point is left.
    """
    inside = points_inside(scene.points, [scene.views[view] for view in scene.train])
    if not inside.any():
        found = f"none of {len(inside):,} points inside the masks"
        advice = "masks are white where the object is: invert them, or read the scene without"
        raise SceneError(scene.root / "masks", found=found, expected="some", advice=advice)
    note = f"{int((~inside).sum()):,} of {len(inside):,} points lie outside the masks: left out"
    return replace(
        scene, points=scene.points[inside], colors=scene.colors[inside], notes=(*scene.notes, note)
    )


def _split(
    listing: SceneRecords, views: Sequence[View], near: Sequence[int], split: Split
) -> tuple[tuple[int, ...], tuple[int, ...], tuple[str, ...]]:
    """Training views, test views and notes, of the views whose poses can be."""
    if listing.lists is not None:
        return listing.lists.divide([view.name for view in views], near, split)
    names = [views[i].name for i in near]
    train, test, notes = split_names(listing.path, names, split)
    return tuple(near[i] for i in train), tuple(near[i] for i in test), notes


def _left_out(far: Sequence[str], count: int) -> tuple[str, ...]:
    if not far:
        return ()
    return (f"{len(far)} of {count} cameras stand far outside and were left out: {listed(far)}",)


def _without_far_points(scene: Scene, listing: Path) -> Scene:
    """The scene without points far outside of it; their number is among its notes.

    Raises:
        SceneError: The remaining points are beyond any plausible size.
    """
    far = far_points(scene.points, scene.extent)
    points, colors, notes = scene.points[~far], scene.colors[~far], scene.notes
    large = (np.abs(points) >= LARGEST).any(axis=1)
    if large.any():
        bad = int(np.flatnonzero(~far)[large][0])
        found, wanted = scene.points[bad].tolist(), f"finite numbers below {LARGEST:g}"
        raise SceneError(listing, f"point {bad} xyz", found=found, expected=wanted)
    if far.any():
        count = f"{int(far.sum()):,} of {len(far):,} points"
        notes += (f"{count} lie far outside and were left out",)
    return replace(scene, points=points, colors=colors, notes=notes)


def _read(path: Path, reading: SceneOptions) -> SceneRecords:
    if not path.is_dir():
        found = "a file" if path.exists() else "no such folder"
        raise SceneError(path, found=found, expected="the folder of a scene")
    models, transforms = find_models(path), find_transforms(path)
    if transforms and not any(in_sparse(path, model) for model in models):
        if reading.images:
            found, wanted = reading.images, "none: a transforms.json names its photos itself"
            raise SceneError(path, "--images", found=found, expected=wanted)
        listing = read_transforms(path, transforms)
        beside = not_read(
            path, [PlacedModel(model, path) for model in models], "take the json file away"
        )
    elif models:
        images = path / reading.images if reading.images else None
        best, *others = best_model(path, models, images)
        listing = read_colmap(path, best.folder, best.photos)
        beside = not_read(path, others, "take the others away")
        beside += tuple(
            f"{file.name} is not read: to use it, take the models away" for file in transforms
        )
    else:
        listing, beside = find_program(path)
        if listing is None:
            raise _no_poses(path, beside)
        beside += other_poses(path, photo_folder(path), read=True)
    if models or transforms:
        beside += other_poses(path, photo_folder(path))
    account = listing.account.with_unread_models(*beside)
    return replace(listing, account=account.joined(estimated_account(path)))


def _no_poses(path: Path, unread: tuple[str, ...]) -> SceneError:
    photos = count_photos(path)
    if photos:
        found, expected = f"{photos} photos without camera poses", "photos with poses"
        beside = (*unread, *other_poses(path, photo_folder(path), read=True), *models_above(path))
        advice = "; ".join((poses_advice(path), *beside))
        return NoPosesError(path, found=found, expected=expected, advice=advice)
    below = places_below(path)
    return SceneError(
        path,
        found="neither a model in sparse/0 nor a transforms.json",
        expected="a scene",
        advice=f"give one of the folders in it: {listed(below)}"
        if below
        else "give a folder with images/ and sparse/0/ (COLMAP) or with a transforms.json",
    )
