"""Photos of a folder, made ready for structure from motion: whole, once each, upright."""

import hashlib
import os
import re
import shutil
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import repeat
from pathlib import Path

from PIL import Image, ImageOps

from gsynopsis.errors import SceneError
from gsynopsis.files import open_regular
from gsynopsis.scene.account import Account, listed, unread_text
from gsynopsis.scene.panoramas import NOT_ONE, is_panorama, is_sphere, is_wide
from gsynopsis.scene.photos import MASK_SUFFIXES, PhotoForm, decode_small, load_photo
from gsynopsis.scene.search import endings_of, files_in, without_masks
from gsynopsis.scene.spheres import VIEWS, Cut, cuts_of
from gsynopsis.scene.stored import (
    DECODING,
    QUARTER_TURNS,
    SIXTEEN,
    colors_of,
    exif_of,
    has_alpha,
    in_8_bits,
    in_srgb,
    opened_photo,
    orientation_of,
    profile_notes,
)

Tick = Callable[[int, int], None]
FEWEST = 3
"""Photos that a reconstruction needs."""
MAKE, MODEL, LENS, FOCAL = 0x010F, 0x0110, 0x920A, 0xA405
"""EXIF tags: maker, camera, focal length, focal length on 35 mm film."""
QUALITY = 95
"""Quality of JPEG photos that had to be turned."""


@dataclass(frozen=True)
class Photo:
    """One photo on disk.

    Attributes:
        name: Relative to the folder of photos, with forward slashes; blanks, which COLMAP's lists
            cannot hold, are underscores. Photos that are neither JPEG nor PNG have `.png` behind.
        path: Where it lies.
        digest: SHA-256 of its bytes, hex.
        size: Width and height in pixels as people see it, upright.
        turned: Its EXIF orientation says that its pixels are not upright.
        lens: Photos of one size with equal text have one lens and focal length.
        panorama: It is taken for one, see `panoramas`.
        colors: See `stored.PhotoHeader`.
        plain: COLMAP reads the file as it is: JPEG or PNG of 8 bits.
        sphere: It is a panorama of the whole sphere, which can be cut.
        cut: It is this view of the panorama at `path`; None: a photo as it is.
    """

    name: str
    path: Path
    digest: str
    size: tuple[int, int]
    turned: bool
    lens: str
    panorama: bool
    colors: str
    plain: bool = True
    sphere: bool = False
    cut: Cut | None = None


@dataclass(frozen=True)
class PhotoSet:
    """The photos of a folder.

    Attributes:
        folder: Their folder.
        photos: Undamaged ones, sorted by name, each once.
        account: Files left out, by reason, and files that are not read.
        taken: A sentence on the video of which they are frames; empty if there is none.
        masks: Masks by the photos' names.
    """

    folder: Path
    photos: tuple[Photo, ...]
    account: Account
    taken: str = ""
    masks: Mapping[str, Path] = field(default_factory=dict[str, Path])

    @property
    def notes(self) -> tuple[str, ...]:
        """Origin of the photos, and the photos left out by reason, a sentence each."""
        left_out = self.account.left_out.items()
        out = (f"{len(n)} photos left out, {why}: {listed(n)}" for why, n in left_out)
        wide = profile_notes(photo.colors for photo in self.photos)
        return (*([self.taken] if self.taken else []), *out, *wide)

    @property
    def digest(self) -> str:
        """Identity of all photos together and their masks, SHA-256, hex."""
        whole = hashlib.sha256()
        for photo in self.photos:
            whole.update(f"{photo.name}\0{photo.digest}\n".encode())
        for name, mask in sorted(self.masks.items()):
            whole.update(f"{name}\0{digest_of(mask)}\n".encode())
        return whole.hexdigest()


def digest_of(path: Path) -> str:
    """SHA-256 of a file, hex.

    Raises:
        SceneError: It is not a regular file, or cannot be read.
    """
    with open_regular(path, SceneError) as file:
        try:
            return hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as error:
            raise SceneError(path, found=error.strerror, expected="a readable file") from error


def gather(folder: Path, tick: Tick | None = None, *, filmed: bool = False) -> PhotoSet:
    """All photos in a folder and its subfolders but `masks`; damaged ones and copies are left out.

    Args:
        folder: Folder of photos.
        tick: Called after each photo with the number opened and the number of all.
        filmed: The photos are frames of a video.

    Raises:
        SceneError: There is no such folder, fewer than three photos are usable, or there are
            panoramas among them that cannot be cut.
    """
    if not folder.is_dir():
        found = "a file" if folder.exists() else "no such folder"
        raise SceneError(folder, found=found, expected="a folder of photos, or a video")
    files = sorted(path for path in files_in(folder) if path.is_file())
    paths = sorted(without_masks(files))
    with ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
        photos, damaged, copies = list[Photo](), list[str](), list[str]()
        seen: dict[str, str] = {}
        results = pool.map(_opened, paths, repeat(folder), repeat(filmed))
        for done, (path, photo) in enumerate(zip(paths, results, strict=True), start=1):
            if photo is None:
                damaged.append(path.relative_to(folder).as_posix())
            elif photo.digest in seen or photo.name in seen.values():
                copies.append(photo.name)
            else:
                seen[photo.digest] = photo.name
                photos.append(photo)
            if tick:
                tick(done, len(paths))
    if filmed and 2 * sum(photo.panorama for photo in photos) <= len(photos):
        photos = [replace(photo, panorama=False) for photo in photos]  # some look like it
    _check_panoramas(folder, photos)
    account = Account().without("cannot be read", damaged).without("copies of others", copies)
    account = replace(account, unread=endings_of(files, folder))
    gathered = PhotoSet(folder, tuple(sorted(photos, key=lambda photo: photo.name)), account)
    if len(photos) < FEWEST:
        told = [*gathered.notes, *unread_text(account.unread)]
        found = f"{len(photos)} photos of use" + (f" ({'; '.join(told)})" if told else "")
        advice = "take 20 or more from all sides, each overlapping the next by two thirds"
        raise SceneError(folder, found=found, expected=f"at least {FEWEST}", advice=advice)
    return gathered


def _check_panoramas(folder: Path, photos: Sequence[Photo]) -> None:
    """Refuses panoramas that cannot be cut, also some among other photos.

    Raises:
        SceneError: There are some.
    """
    names = [photo.name for photo in photos if photo.panorama and not photo.sphere]
    if names:
        found = f"{len(names)} of {len(photos)} photos that are or look like panoramas"
        raise SceneError(
            folder,
            found=f"{found} ({listed(names)})",
            expected="photos of a perspective or fisheye lens",
            advice=NOT_ONE,
        )


def with_cuts(gathered: PhotoSet) -> PhotoSet:
    """The photos with the views of each panorama in its place, in folders of their own."""
    spheres = [photo for photo in gathered.photos if photo.panorama and photo.sphere]
    if not spheres:
        return gathered
    # One rig for all: views of one size.
    like = min(photo.size for photo in spheres)
    views, masks = list[Photo](), dict(gathered.masks)
    for photo in spheres:
        mask = masks.pop(photo.name, None)
        for number, cut in enumerate(cuts_of(photo.size, like)):
            name, size = f"{view_folder(number)}{photo.name}", cut.pinhole[:2]
            made = replace(photo, name=name, size=size, turned=False, lens=f"view {number}")
            views.append(replace(made, panorama=False, cut=cut))
            if mask is not None:
                masks[name] = mask
    others = [photo for photo in gathered.photos if photo not in spheres]
    photos = tuple(sorted([*others, *views], key=lambda photo: photo.name))
    told = f"{len(spheres)} panoramas are cut into {VIEWS} views each"
    taken = f"{gathered.taken}; {told}" if gathered.taken else told
    return replace(gathered, photos=photos, masks=masks, taken=taken)


def view_folder(number: int) -> str:
    """The folder of a view of all panoramas, as it begins names."""
    return f"view{number}/"


def prepare(gathered: PhotoSet, out: Path) -> None:
    """Puts the photos into a folder: links, or copies that are upright and in sRGB.

    Those that are there stay.
    """
    for photo in gathered.photos:
        path = out / photo.name
        if path.exists():
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        draft = path.with_name(f".{path.name}")
        draft.unlink(missing_ok=True)
        if photo.cut is not None:
            _cut(photo, photo.cut, draft)
        elif photo.turned or photo.colors or not photo.plain:
            _normalize(photo.path, draft)
        else:
            _link(photo.path, draft)
        os.replace(draft, path)


def _cut(photo: Photo, cut: Cut, target: Path) -> None:
    pixels = load_photo(photo.path, 1, form=PhotoForm(turned=photo.turned, warp=cut))
    kind = "JPEG" if photo.path.suffix.lower() in (".jpg", ".jpeg") else "PNG"
    options = {"quality": QUALITY, "subsampling": 0} if kind == "JPEG" else {}
    Image.fromarray(pixels).save(target, kind, **options)


def _normalize(source: Path, target: Path) -> None:
    with opened_photo(source) as image, DECODING.of(image):
        # MPO of phones is a JPEG, and what follows it in the file.
        kind = "JPEG" if image.format in ("JPEG", "MPO") else "PNG"
        plain = in_8_bits(image)
        upright = ImageOps.exif_transpose(plain)
        exif = upright.getexif()
        if kind == "PNG" and upright.mode not in ("L", "RGB", "RGBA"):
            upright = upright.convert("RGBA" if has_alpha(upright) else "RGB")
        upright = in_srgb(upright, image.info.get("icc_profile"))
        options = {"quality": QUALITY, "subsampling": 0} if kind == "JPEG" else {}
        upright.save(target, kind, exif=exif, icc_profile=None, **options)


def _link(source: Path, target: Path) -> None:
    try:
        target.symlink_to(source.resolve())
    except OSError:  # file systems without links
        shutil.copyfile(source, target)


def _opened(path: Path, folder: Path, filmed: bool) -> Photo | None:
    """A photo whose pixels were all decoded; None if that cannot be done."""
    try:
        with opened_photo(path) as image:
            tags, (width, height) = exif_of(image), image.size
            detail, turn = tags.get_ifd(0x8769), orientation_of(image)
            shaped, colors = is_wide(image), colors_of(image)
            decode_small(image)
            panorama = is_panorama(image, shaped=shaped, filmed=filmed)
            plain = image.format in ("JPEG", "MPO", "PNG") and not image.mode.startswith(SIXTEEN)
            sphere = panorama and shaped and is_sphere(image)
        digest = digest_of(path)  # last: what is no photo may be very long
    except SceneError:
        return None
    size = (height, width) if turn in QUARTER_TURNS else (width, height)
    facts = [tags.get(MAKE), tags.get(MODEL), detail.get(LENS), detail.get(FOCAL)]
    lens = " ".join(str(fact) for fact in facts if fact is not None)
    name = re.sub(r"\s", "_", path.relative_to(folder).as_posix())
    name = name if path.suffix.lower() in MASK_SUFFIXES else f"{name}.png"
    return Photo(name, path, digest, size, turn != 1, lens, panorama, colors, plain, sphere)
