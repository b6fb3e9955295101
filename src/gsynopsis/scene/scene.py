"""Photos, cameras and points in memory: all that every other room sees of the input."""

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gsynopsis.scene.account import Account
from gsynopsis.scene.backdrop import backdrop_points
from gsynopsis.scene.camera import STILL, Camera, Shift, positions_of
from gsynopsis.scene.masks import INSIDE, MaskUse, load_mask
from gsynopsis.scene.photos import AS_STORED, PhotoForm, load_photo
from gsynopsis.scene.splits import Split
from gsynopsis.scene.views import View, spread

CACHE_BYTES = 1 << 30
"""Decoded pixels a scene keeps by default, bytes (1 GiB: 300 photos of 1000 × 1000)."""
Key = tuple[Path, float, Shift, PhotoForm]


class PhotoSource(Protocol):
    """Gives decoded images, see `load_photo`."""

    def get(self, path: Path, factor: float, shift: Shift, form: PhotoForm) -> NDArray[np.uint8]:
        """The image of `load_photo`."""
        ...

    def expect(self, path: Path, factor: float, shifts: Sequence[Shift], form: PhotoForm) -> None:
        """These will be asked for next."""
        ...


class PhotoCache:
    """Decoded images by path, factor, shift and form.

    The least recently used go when the budget is full. With a store nothing is held in memory: it
    gives all images.

    For use from several threads: one of them decodes at a time.
    """

    def __init__(self, budget: int = CACHE_BYTES) -> None:
        self.budget = budget
        self.store: PhotoSource | None = None
        self.held = 0
        self._images: OrderedDict[Key, NDArray[np.uint8]] = OrderedDict()
        self._lock = threading.Lock()

    def get(
        self, path: Path, factor: float, shift: Shift = STILL, form: PhotoForm = AS_STORED
    ) -> NDArray[np.uint8]:
        """The image of `load_photo`, the same array as before while it is held."""
        if self.store is not None:
            return self.store.get(path, factor, shift, form)
        key = (path, factor, shift, form)
        with self._lock:
            if key in self._images:
                self._images.move_to_end(key)
                return self._images[key]
            pixels = load_photo(path, factor, shift, form)
            self._images[key] = pixels
            self.held += pixels.nbytes
            while self.held > self.budget and len(self._images) > 1:
                self.held -= self._images.popitem(last=False)[1].nbytes
            return pixels


@dataclass(frozen=True)
class SceneOptions:
    """Options of reading a scene's folder.

    Attributes:
        images: Folder of the photos as seen from the scene's; empty: `images`. Photos there may be
            copies of another size. For COLMAP models only.
        masks: Use of masks, see `masks.MaskUse`.
        points: PLY as seen from the scene's folder, with points for files that have none; empty:
            random ones. See `capture.triangulate`.
    """

    images: str = ""
    masks: MaskUse = "loss"
    points: str = ""


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
        up: Away from the ground, not zero; None: as the cameras have it.
        random_points: True if the files have no points, and random ones stand in.

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
    up: tuple[float, float, float] | None = None
    random_points: bool = False

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
        own, store = self.views[view], self.cache.store
        if own.mask is None:
            return None
        return load_mask(own, factor, shift, load_photo if store is None else store.get)

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

    def judged(self, view: int, factor: float = 1) -> NDArray[np.bool_] | None:
        """Pixels of a view that a model is judged by, bool [H, W]; None: all.

        Those inside its mask, unless the outside is trained to be empty.
        """
        return None if self.reading.masks == "empty" else self.inside(view, factor)

    @cached_property
    def extent(self) -> float:
        """1.1 × the largest distance of a training camera from their mean (methods.md §1.2.5).

        World units, > 0. Where all training cameras stand in one place, test cameras count too.
        """
        every = positions_of(view.camera for view in self.views)
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
