"""Masks of photos: which pixels count, and which sparse points lie within.

A mask is white where the object is, and has its photo's size or is a copy of another size. It lies
in `masks/` or `mask/` under its photo's name, see `MaskFolder`, or a transforms.json names it.
"""

import shutil
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gsynopsis.errors import SceneError
from gsynopsis.scene.camera import STILL, Shift
from gsynopsis.scene.colmap.distortion import Warp
from gsynopsis.scene.photos import PhotoForm, is_photo, load_photo
from gsynopsis.scene.search import MASK_ENDS, MASK_FOLDERS, MASK_KINDS, folded
from gsynopsis.scene.spheres import Cut
from gsynopsis.scene.stored import read_header
from gsynopsis.scene.views import SceneRecords, View, photo_name, same_shape

MaskUse = Literal["loss", "empty", "alpha", "off"]
"""Pixels outside do not count; they are trained to be empty; as the first, with the photos' alpha
channels as masks; masks are ignored."""
INSIDE = 0.5
"""A pixel with at least this share of white is inside, and so is a point in this share of photos
that have it in their frame."""
COARSE_PIXELS = 320
"""Width at which points are looked up in masks."""


def with_masks(root: Path, listing: SceneRecords, use: MaskUse) -> SceneRecords:
    """The listing with the masks that there are, counted in its notes and its account.

    Masks that the listing names for its photos go before those of a folder.

    Raises:
        SceneError: A mask is missing, unreadable or of another shape than its photo; or a folder
            of masks has none for any photo.
    """
    folders = mask_folders(root)
    if use == "off":
        views = tuple(replace(view, mask=None) for view in listing.views)
        account = replace(listing.account, masks="not looked at, as asked")
        return replace(listing, views=views, account=account)
    views, source = _masked(listing, folders, use)
    if not source:
        if use != "loss":
            raise no_masks(root, use)
        return listing
    for view in views:
        _check_size(view)
    unread = [folder for folder in folders if source != _in(folder)]
    account = listing.account.with_unread_models(*(f"{f.name}/ is not read" for f in unread))
    count = sum(view.mask is not None for view in views)
    missing = "" if count == len(views) else "; photos without one count whole"
    counted = f"{count} of {len(views)} photos"
    outside = "empty outside of them" if use == "empty" else "what is outside does not count"
    account = replace(account, masks=f"{counted}, {source}{missing}; {outside}")
    notes = (*listing.notes, f"masks of {counted}{missing}")
    return replace(listing, views=views, notes=notes, account=account)


def _masked(
    listing: SceneRecords, folders: Sequence[Path], use: MaskUse
) -> tuple[tuple[View, ...], str]:
    """The views with masks, and where those are; empty text if there are none."""
    views = listing.views
    if use == "alpha":
        own = [replace(v, mask=v.path) if read_header(v.path).alpha else v for v in views]
        if any(view.mask == view.path for view in own):
            return tuple(own), "their alpha channels"
    if any(view.mask for view in views):
        return views, f"named by {listing.path.name}"
    if folders:
        return _of_folder(folders[0], views), _in(folders[0])
    beside = tuple(replace(view, mask=mask_beside(view.path)) for view in views)
    return beside, "beside the photos" if any(view.mask for view in beside) else ""


def _in(folder: Path) -> str:
    return f"in {folder.name}/"


def mask_beside(photo: Path) -> Path | None:
    """The mask that lies beside a photo, for `b.jpg` as `b_mask.png`; None if there is none."""
    for stem in (photo.stem, photo.name):
        for end in MASK_ENDS:
            for kind in MASK_KINDS:
                path = photo.with_name(f"{stem}{end}{kind}")
                if path.is_file():
                    return path
    return None


def mask_folders(root: Path) -> list[Path]:
    """Folders of masks in a scene's: masks/, then mask/, in any case of letters."""
    found = [path for path in root.iterdir() if path.is_dir() and folded(path.name) in MASK_FOLDERS]
    return sorted(found, key=lambda path: (folded(path.name) != "masks", path.name))


class MaskFolder:
    """Masks of a folder by the names of photos, in any case of letters.

    For `a/b.jpg` that is `a/b.png`, `a/b.jpg.png`, `a/b_mask.png` or `a/b.mask.png`, or any of
    these as JPEG; the folder of the photos (`images/`) may be left out.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._files = {
            folded(path.relative_to(folder).as_posix()): path
            for path in sorted(folder.rglob("*"))
            if is_photo(path) and path.is_file()
        }

    def find(self, name: str) -> Path | None:
        """The mask of a photo; None if it has none."""
        whole = PurePosixPath(name)
        for photo in (whole, PurePosixPath(*whole.parts[1:])):
            for stem in (photo.with_suffix(""), photo) if photo.name else ():
                for end in ("", *MASK_ENDS):
                    for kind in MASK_KINDS:
                        path = self._files.get(folded(f"{stem}{end}{kind}"))
                        if path is not None:
                            return path
        return None


def _of_folder(folder: Path, views: Sequence[View]) -> tuple[View, ...]:
    masks = MaskFolder(folder)
    found = tuple(replace(view, mask=masks.find(photo_name(view))) for view in views)
    if all(view.mask is None for view in found):
        raise no_mask(folder, views[0].name)
    return found


def no_mask(folder: Path, photo: str) -> SceneError:
    """The error of a folder of masks that has none for any photo."""
    names = f"{folder.name}/{PurePosixPath(photo).with_suffix('.png')}"
    return SceneError(folder, found="no mask of any photo", expected=f"files such as {names}")


def no_masks(root: Path, use: MaskUse) -> SceneError:
    """The error of a scene without masks where somebody asked for them."""
    wanted = f"masks, for --masks {use}"
    advice = "put them into masks/, one for each photo, white where the object is"
    if use == "alpha":
        wanted, advice = "photos with an alpha channel, for --masks alpha", "give cut-outs as PNG"
    return SceneError(root, "masks", found="none", expected=wanted, advice=advice)


def _check_size(view: View) -> None:
    if view.mask not in (None, view.path):
        check_mask_shape(view.mask, _upright(view))


def check_mask_shape(mask: Path, wanted: tuple[int, int]) -> None:
    """Refuse a mask of another shape than its photo, whose width and height are `wanted`.

    Raises:
        SceneError: it is of another shape, or unreadable.
    """
    size = read_header(mask).size
    if size != wanted and not same_shape(size, wanted):
        raise SceneError(
            mask,
            "mask size",
            found=f"{size[0]}x{size[1]}",
            expected=f"{wanted[0]}x{wanted[1]} as its photo, or a copy of another size",
        )


def _upright(view: View) -> tuple[int, int]:
    """Width and height of a photo after it was turned, before distortion is taken out."""
    warp = view.form.warp
    return (view.camera.width, view.camera.height) if warp is None else warp.size


def warp_masks(
    masks: Mapping[str, Path],
    warps: Mapping[str, Warp | Cut],
    out: Path,
    own: Collection[str] = (),
) -> None:
    """Masks of photos as their pinhole images have them, into a folder, whole or not at all.

    Args:
        masks: By the photos' names.
        warps: What became of each photo that was placed.
        out: Replaced.
        own: Names of photos that are their own masks, by their alpha channels.
    """
    shutil.rmtree(out, ignore_errors=True)
    draft = out.with_name(f".{out.name}")
    shutil.rmtree(draft, ignore_errors=True)
    for name in masks.keys() & warps.keys():
        warp = warps[name]
        form = PhotoForm(turned=name in own, warp=warp, size=warp.size)
        form = replace(form, mask="alpha" if name in own else "grey")
        pixels = load_photo(masks[name], 1, form=form)
        path = draft / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(pixels[:, :, 0]).save(path)
    if draft.exists():
        draft.rename(out)


def load_mask(
    view: View,
    factor: float,
    shift: Shift = STILL,
    load: Callable[[Path, float, Shift, PhotoForm], NDArray[np.uint8]] = load_photo,
) -> NDArray[np.float32]:
    """The share of white in each pixel of a view's mask divided by `factor`, float32 [H, W].

    The view has a mask. `load` is as `load_photo`.

    Raises:
        SceneError: The pixel data cannot be decoded.
    """
    assert view.mask is not None
    if view.mask == view.path:
        form = replace(view.form, mask="alpha")
    else:
        form = replace(view.form, turned=False, size=_upright(view), mask="grey")
    pixels = load(view.mask, factor, shift, form)
    return pixels[:, :, 0].astype(np.float32) / np.float32(255)


def check_masks(views: Iterable[View]) -> Iterator[View]:
    """Decodes the masks of views; gives each view once its mask is known to be good.

    Raises:
        SceneError: One cannot be decoded, or is black all over.
    """
    for view in views:
        if view.mask is not None and float(load_mask(view, 1).max()) < INSIDE:
            raise SceneError(
                view.mask,
                "mask",
                found="black all over",
                expected="white where the object is",
                advice="invert it, or take it away: the photo then counts whole",
            )
        yield view


def points_inside(points: NDArray[np.float64], views: Iterable[View]) -> NDArray[np.bool_]:
    """Points [P, 3] inside the masks of half of the photos that have them in frame, bool [P].

    Photos without a mask do not count.
    """
    inside, seen = np.zeros(len(points)), np.zeros(len(points))
    for view in views:
        if view.mask is None:
            continue
        factor = max(1.0, view.camera.width / COARSE_PIXELS)
        mask = load_mask(view, factor)
        framed = view.camera.scaled(factor).framed(points)
        seen += framed.which
        inside[framed.which] += mask[framed.rows, framed.columns] >= INSIDE
    return (seen > 0) & (inside >= INSIDE * seen)
