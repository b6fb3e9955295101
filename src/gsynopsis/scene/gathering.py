"""Photos of a folder, made ready for structure from motion: whole, once each, upright."""

import hashlib
import os
import re
import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path

from PIL import ImageOps

from gsynopsis.errors import InputError, SceneError
from gsynopsis.regular import open_regular
from gsynopsis.scene.photos import decode_small
from gsynopsis.scene.stored import DECODING, QUARTER_TURNS, opened_photo, orientation_of
from gsynopsis.scene.transforms import SUFFIXES

Tick = Callable[[int, int], None]
FEWEST = 3
"""Photos that a reconstruction needs."""
MAKE, MODEL, LENS, FOCAL = 0x010F, 0x0110, 0x920A, 0xA405
"""EXIF tags: maker, camera, focal length, focal length on 35 mm film."""
QUALITY = 95
"""Of JPEG photos that had to be turned."""


@dataclass(frozen=True)
class Photo:
    """One photo on disk.

    Attributes:
        name: Relative to the folder of photos, with forward slashes; blanks, which COLMAP's lists
            cannot hold, are underscores.
        path: Where it lies.
        digest: SHA-256 of its bytes, hex.
        size: Width and height in pixels as people see it, upright.
        turned: Its EXIF orientation says that its pixels are not upright.
        lens: Photos of one size with equal text have one lens and focal length.
    """

    name: str
    path: Path
    digest: str
    size: tuple[int, int]
    turned: bool
    lens: str


@dataclass(frozen=True)
class Gathered:
    """The photos of a folder.

    Attributes:
        folder: Where they lie.
        photos: Whole ones, sorted by name, each once.
        notes: What was left out and why, a sentence each.
    """

    folder: Path
    photos: tuple[Photo, ...]
    notes: tuple[str, ...]

    @property
    def digest(self) -> str:
        """Identity of all photos together, SHA-256, hex."""
        whole = hashlib.sha256()
        for photo in self.photos:
            whole.update(f"{photo.name}\0{photo.digest}\n".encode())
        return whole.hexdigest()


def photo_folder(root: Path) -> Path:
    """`root/images` if there is such a folder, else `root`."""
    return root / "images" if (root / "images").is_dir() else root


def gather(folder: Path, tick: Tick | None = None) -> Gathered:
    """All photos in a folder and its subfolders but `masks`; damaged ones and copies are left out.

    Args:
        folder: Of photos.
        tick: Told after each photo how many were opened, and how many there are.

    Raises:
        SceneError: There is no such folder, or fewer than three photos are of use.
    """
    if not folder.is_dir():
        found = "a file" if folder.exists() else "no such folder"
        raise SceneError(folder, found=found, expected="a folder of photos, or a video")
    paths = [path for path in sorted(folder.rglob("*")) if _counts(path, folder)]
    with ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
        photos, damaged, copies = list[Photo](), list[str](), list[str]()
        seen: dict[str, str] = {}
        results = pool.map(_opened, paths, repeat(folder))
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
    notes = _left_out("cannot be read", damaged) + _left_out("copies of others", copies)
    if len(photos) < FEWEST:
        found = f"{len(photos)} photos of use" + (f" ({'; '.join(notes)})" if notes else "")
        advice = "take 20 or more from all sides, each overlapping the next by two thirds"
        raise SceneError(folder, found=found, expected=f"at least {FEWEST}", advice=advice)
    return Gathered(folder, tuple(sorted(photos, key=lambda photo: photo.name)), notes)


def prepare(gathered: Gathered, out: Path) -> None:
    """Puts the photos into a folder: upright ones as links, others turned; those there stay."""
    for photo in gathered.photos:
        path = out / photo.name
        if path.exists():
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        draft = path.with_name(f".{path.name}")
        draft.unlink(missing_ok=True)
        if photo.turned:
            _turn(photo.path, draft)
        else:
            _link(photo.path, draft)
        os.replace(draft, path)


def _turn(source: Path, target: Path) -> None:
    with opened_photo(source) as image, DECODING.of(image):
        kind = image.format
        upright = ImageOps.exif_transpose(image)
        options = {"quality": QUALITY, "subsampling": 0} if kind == "JPEG" else {}
        upright.save(target, kind, exif=upright.getexif(), **options)


def _link(source: Path, target: Path) -> None:
    try:
        target.symlink_to(source.resolve())
    except OSError:  # file systems without links
        shutil.copyfile(source, target)


def _counts(path: Path, folder: Path) -> bool:
    """Whether a file is a photo of the folder: not hidden, and not a mask."""
    parts = path.relative_to(folder).parts
    hidden = any(part.startswith(".") or part == "masks" for part in parts)
    return path.suffix in SUFFIXES and not hidden and path.is_file()


def _opened(path: Path, folder: Path) -> Photo | None:
    """A photo whose pixels were all decoded; None if that cannot be done."""
    try:
        with open_regular(path) as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        with opened_photo(path) as image:
            tags, (width, height) = image.getexif(), image.size
            detail, turn = tags.get_ifd(0x8769), orientation_of(image)
            decode_small(image)
    except (InputError, OSError):
        return None
    size = (height, width) if turn in QUARTER_TURNS else (width, height)
    facts = [tags.get(MAKE), tags.get(MODEL), detail.get(LENS), detail.get(FOCAL)]
    lens = " ".join(str(fact) for fact in facts if fact is not None)
    name = re.sub(r"\s", "_", path.relative_to(folder).as_posix())
    return Photo(name, path, digest, size, turn != 1, lens)


def _left_out(why: str, names: list[str]) -> tuple[str, ...]:
    if not names:
        return ()
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return (f"{len(names)} photos left out, {why}: {', '.join(names[:3])}{more}",)
