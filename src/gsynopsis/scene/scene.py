"""Photos and poses → `Scene`: what every other room sees of the input."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import NoPosesError, SceneError
from gsynopsis.scene.account import Account, estimated_account, listed
from gsynopsis.scene.backdrop import backdrop_points
from gsynopsis.scene.camera import STILL, Camera, Shift
from gsynopsis.scene.colmap.model import LARGEST, poses_advice
from gsynopsis.scene.colmap.read import PlacedModel, best_model, not_read, read_colmap
from gsynopsis.scene.masks import INSIDE, MaskUse, load_mask, points_inside, with_masks
from gsynopsis.scene.other_poses import models_above, other_poses
from gsynopsis.scene.outliers import far_cameras, far_points
from gsynopsis.scene.photos import PhotoCache, load_photo
from gsynopsis.scene.programs.find import find_program
from gsynopsis.scene.search import count_photos, find_models, in_sparse, photo_folder
from gsynopsis.scene.splits import Split, split_names
from gsynopsis.scene.transforms import find_transforms, read_transforms
from gsynopsis.scene.views import (
    SceneRecords,
    View,
    check_listing,
    near_origin,
    parallax_notes,
    spread,
    with_fallback_points,
)


@dataclass(frozen=True)
class SceneOptions:
    """Options of reading a scene's folder.

    Attributes:
        images: Folder of the photos as seen from the scene's; empty: `images`. Photos there may be
            copies of another size. For COLMAP models only.
        masks: Use of masks, see `masks.MaskUse`.
    """

    images: str = ""
    masks: MaskUse = "loss"


DEFAULT_OPTIONS = SceneOptions()


@dataclass(frozen=True, eq=False)
class Scene:
    """Posed photos and the sparse points seen in them.

    Attributes:
        name: Short name, from the folder.
        root: The folder it was loaded from.
        views: Sorted by name; a view is known to the rest of the program by its index here.
        points: Sparse points, float64 [P, 3], world units.
        colors: Their colours, uint8 [P, 3], sRGB.
        train: Indices of the views to learn from, ascending, not empty.
        test: Indices of the held-out views, ascending, not empty. A view that is in neither has a
            pose far outside, see `outliers`.
        split: The rule that chose them.
        notes: Oddities in how the scene was read, for readers of results, a sentence each.
        reading: How it was read.
        account: Account of the folder: files used, and files that are not.
        shift: What was taken from all coordinates, world units; 0 but where float32 needs it.

    Examples:
        >>> scene = gs.load_scene("scene")
        >>> scene
        Scene(scene: 10 training views and 2 held out, 96 × 64 pixels, 6,000 points)
        >>> scene.image(0, 2).shape, scene.camera(0, 2).width
        ((32, 48, 3), 48)
    """

    name: str
    root: Path
    views: tuple[View, ...]
    points: NDArray[np.float64]  # [P, 3]
    colors: NDArray[np.uint8]  # [P, 3]
    train: tuple[int, ...]
    test: tuple[int, ...]
    notes: tuple[str, ...] = ()
    split: Split = "every8"
    cache: PhotoCache = field(default_factory=PhotoCache, repr=False)
    reading: SceneOptions = DEFAULT_OPTIONS
    account: Account = field(default_factory=Account)
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __repr__(self) -> str:
        """Counts; poses and points of a scene fill pages."""
        first = self.views[0].camera
        return (
            f"Scene({self.name}: {len(self.train)} training views and {len(self.test)} held out, "
            f"{first.width} × {first.height} pixels, {len(self.points):,} points)"
        )

    def camera(self, view: int, factor: float = 1, shift: Shift = STILL) -> Camera:
        """The camera of a view for its image divided by `factor`, then shifted."""
        return self.views[view].camera.scaled(factor).shifted(shift)

    def image(self, view: int, factor: float = 1, shift: Shift = STILL) -> NDArray[np.uint8]:
        """The image of a view divided by `factor`, uint8 [H, W, 3] sRGB, not writeable.

        Loaded when first asked for and kept while the cache's budget allows; see
        `photos.load_photo` for the resampling.

        Raises:
            SceneError: The pixel data cannot be decoded.
        """
        own = self.views[view]
        image = self.cache.get(own.path, factor, shift, own.form)
        if self.reading.masks != "empty" or own.mask is None:
            return image
        mask = self.mask(view, factor, shift)
        assert mask is not None
        emptied = np.rint(image * mask[:, :, None]).astype(np.uint8)
        emptied.flags.writeable = False
        return emptied

    def mask(
        self, view: int, factor: float = 1, shift: Shift = STILL
    ) -> NDArray[np.float32] | None:
        """The mask of a view divided by `factor`, float32 [H, W] in [0, 1]; None: it has none."""
        store = self.cache.store
        return load_mask(
            self.views[view], factor, shift, load_photo if store is None else store.get
        )

    def expect(self, view: int, factor: float, shifts: Sequence[Shift]) -> None:
        """The images of a view at these shifts are needed soon; prepared where a store is used."""
        if self.cache.store is not None:
            own = self.views[view]
            self.cache.store.expect(own.path, factor, shifts, own.form)

    def inside(self, view: int, factor: float = 1) -> NDArray[np.bool_] | None:
        """Pixels of a view inside its mask, bool [H, W]; None: it has none."""
        mask = self.mask(view, factor)
        return None if mask is None else mask >= INSIDE

    @property
    def masked(self) -> bool:
        """True if any view in use has a mask."""
        return any(self.views[view].mask is not None for view in {*self.train, *self.test})

    @cached_property
    def extent(self) -> float:
        """1.1 × the largest distance of a training camera from their mean (methods.md §1.2.5).

        World units, > 0. Where all training cameras stand in one place, test cameras count too.
        """
        every = np.stack([view.camera.position for view in self.views])
        used = sorted({*self.train, *self.test})
        return 1.1 * (spread(every[list(self.train)]) or spread(every[used]))

    @cached_property
    def backdrop(self) -> NDArray[np.float64]:
        """Points of a far shell where training photos lack sparse points, see `backdrop`.

        None if masks exclude the surroundings.
        """
        if self.masked:
            return np.zeros((0, 3))
        cameras = [self.views[view].camera for view in self.train]
        return backdrop_points(cameras, self.points, self.extent)

    def fingerprint(self) -> str:
        """SHA-256 (hex) over names, cameras and points: the identity that checkpoints hold.

        The split, the notes and the place on disk are not part of it. Poses enter rounded to
        nine decimals, so that the last bit of a platform's arithmetic does not count.
        """
        digest = hashlib.sha256(b"gsynopsis scene 1\n")
        for view in self.views:
            c = view.camera
            digest.update(f"{view.name}\0{c.width} {c.height}\0".encode())
            digest.update(_rounded(np.array([c.fx, c.fy, c.cx, c.cy])))
            digest.update(_rounded(c.w2c))
        digest.update(_rounded(self.points))
        digest.update(np.ascontiguousarray(self.colors).tobytes())
        return digest.hexdigest()


def _rounded(values: NDArray[np.float64]) -> bytes:
    # Adding zero turns -0 into 0.
    return (np.round(values, 9) + 0.0).astype("<f8").tobytes()


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
        listing, shift = near_origin(with_fallback_points(_read(path, reading)))
        listing = replace(listing, notes=listing.notes + check_listing(listing))
        listing = with_masks(path, listing, reading.masks)
    except OSError as error:
        # Folders without permission, names too long for the file system.
        where = error.filename or path
        raise SceneError(where, found=error.strerror, expected="a readable scene") from error
    views = tuple(sorted(listing.views, key=lambda view: view.name))
    far = far_cameras(np.stack([view.camera.position for view in views]))
    near = np.flatnonzero(~far).tolist()
    train, test, notes = _split(listing, views, near, split)
    if not train:
        raise SceneError(listing.path, "frames", found=0, expected="at least 1 view to train on")
    outside = tuple(view.name for view, out in zip(views, far, strict=True) if out)
    name, notes = path.resolve().name, listing.notes + _left_out(outside, len(views)) + notes
    scene = Scene(name, path, views, listing.points, listing.colors, train, test, notes, split)
    used = {*train, *test}
    unlisted = tuple(views[i].name for i in near if i not in used) if listing.lists else ()
    account = listing.account.without("far outside of the others", outside)
    account = replace(
        account.without("of other split lists or none", unlisted),
        photos=len(used),
        split=listing.lists.source if listing.lists else f"rule {split}",
    )
    scene = _without_far_points(
        replace(scene, reading=reading, account=account, shift=shift), listing.path
    )
    places = np.stack([views[view].camera.position for view in near])
    scene = replace(scene, notes=(*scene.notes, *parallax_notes(places, scene.points)))
    return _within_masks(scene) if reading.masks == "empty" and scene.masked else scene


def _within_masks(scene: Scene) -> Scene:
    """The scene without points outside the masks.

    Raises:
        SceneError: No point is left.
    """
    inside = points_inside(scene)
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
    return SceneError(
        path,
        found="neither a model in sparse/0 nor a transforms.json",
        expected="a scene",
        advice="give a folder with images/ and sparse/0/ (COLMAP) or with a transforms.json",
    )
