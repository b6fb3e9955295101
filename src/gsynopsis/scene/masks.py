"""Masks of photos: which pixels count, and which sparse points lie within.

`masks/NAME.png` (NAME without or with the photo's ending) is white where the object is. A mask has
its photo's size, or is a copy of another size.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import SceneError
from gsynopsis.scene.camera import STILL, Shift
from gsynopsis.scene.photos import PhotoForm, load_photo
from gsynopsis.scene.stored import header_size
from gsynopsis.scene.views import View, same_shape

if TYPE_CHECKING:
    from gsynopsis.scene.scene import Scene

MaskUse = Literal["loss", "empty", "off"]
"""Pixels outside do not count; they are trained to be empty; masks are not looked at."""
INSIDE = 0.5
"""A pixel with at least this share of white is inside, and so is a point in this share of photos
that have it in their frame."""
COARSE_PIXELS = 320
"""Width at which points are looked up in masks."""


def with_masks(root: Path, views: Sequence[View]) -> tuple[tuple[View, ...], tuple[str, ...]]:
    """The views with the masks that there are, and a note that says how many.

    Raises:
        SceneError: A mask is unreadable or of another shape than its photo.
    """
    folder = root / "masks"
    if not folder.is_dir():
        return tuple(views), ()
    found = tuple(replace(view, mask=_mask_of(folder, view)) for view in views)
    count = sum(view.mask is not None for view in found)
    if not count:
        names = f"{folder.name}/{Path(views[0].name).with_suffix('.png')}"
        raise SceneError(folder, found="no mask of any photo", expected=f"files such as {names}")
    missing = "" if count == len(found) else "; photos without one count whole"
    return found, (f"masks of {count} of {len(found)} photos{missing}",)


def _mask_of(folder: Path, view: View) -> Path | None:
    name = PurePosixPath(view.name)
    for candidate in (name.with_suffix(".png"), name.with_name(f"{name.name}.png")):
        path = folder / candidate
        if path.is_file():
            size, wanted = header_size(path), _upright(view)
            if size != wanted and not same_shape(size, wanted):
                raise SceneError(
                    path,
                    "mask size",
                    found=f"{size[0]}x{size[1]}",
                    expected=f"{wanted[0]}x{wanted[1]} as its photo, or a copy of another size",
                )
            return path
    return None


def _upright(view: View) -> tuple[int, int]:
    """Width and height of a photo after it was turned, before distortion is taken out."""
    warp = view.form.warp
    return (view.camera.width, view.camera.height) if warp is None else warp.size


def load_mask(
    view: View,
    factor: float,
    shift: Shift = STILL,
    load: Callable[[Path, float, Shift, PhotoForm], NDArray[np.uint8]] = load_photo,
) -> NDArray[np.float32] | None:
    """The share of white in each pixel of a view's image divided by `factor`, float32 [H, W].

    None where the view has no mask. `load` is as `load_photo`.

    Raises:
        SceneError: The pixel data cannot be decoded.
    """
    if view.mask is None:
        return None
    form = replace(view.form, turned=False, size=_upright(view))
    pixels = load(view.mask, factor, shift, form)
    return pixels[:, :, 0].astype(np.float32) / np.float32(255)


def check_masks(scene: "Scene") -> Iterator[int]:
    """Decodes the masks of all views in use; gives the number of each view once it is known good.

    Raises:
        SceneError: One cannot be decoded, or is black all over.
    """
    for view in sorted({*scene.train, *scene.test}):
        mask = load_mask(scene.views[view], 1)
        if mask is not None and float(mask.max()) < INSIDE:
            raise SceneError(
                scene.views[view].mask or scene.root,
                "mask",
                found="black all over",
                expected="white where the object is",
                advice="invert it, or take it away: the photo then counts whole",
            )
        yield view


def points_inside(scene: "Scene") -> NDArray[np.bool_]:
    """Which sparse points lie inside the masks of half of the photos that have them in frame, [P].

    Photos without a mask do not judge.
    """
    inside, seen = np.zeros(len(scene.points)), np.zeros(len(scene.points))
    for view in scene.train:
        factor = max(1.0, scene.views[view].camera.width / COARSE_PIXELS)
        mask = load_mask(scene.views[view], factor)
        if mask is None:
            continue
        framed = scene.camera(view, factor).framed(scene.points)
        seen += framed.which
        inside[framed.which] += mask[framed.rows, framed.columns] >= INSIDE
    return (seen > 0) & (inside >= INSIDE * seen)
