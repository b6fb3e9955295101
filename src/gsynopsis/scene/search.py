"""The search of a scene's folder: COLMAP models, photos, and poses of other programs."""

import os
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from gsynopsis.scene.account import listed
from gsynopsis.scene.photos import is_photo

MODEL_FILES = ("cameras", "images", "points3D")
MODEL_FOLDER = re.compile(
    r"((sparse|colmap)(_(text|txt|bin|sparse|output|undistorted))?|dense|(un)?distorted|mvs)", re.I
)
"""Folders in which COLMAP and programs around it leave models, or folders with models.

For example sparse/0, dense/0/sparse, colmap_text. No others: a folder of several scenes is not a
scene.
"""
LAST_FOLDER = re.compile(r"\d+|text|txt|bin|models?", re.I)
"""Folders that may hold a model themselves; below one of the others also folders with models."""
DEPTH = 4
"""Depth of the search for models below the scene's folder."""
ORIGINALS = "input"
"""Folder of the photos that gaussian-splatting's convert.py begins with, before undistortion."""
PHOTO_FOLDERS = ("images", ORIGINALS)
"""Names of folders of photos."""
MASK_FOLDERS = {"masks", "mask"}
MASK_ENDS, MASK_KINDS = ("_mask", ".mask"), (".png", ".jpg", ".jpeg")
"""Ends of names of masks that lie beside their photos, `a_mask.png` beside `a.jpg`."""
NO_PICTURES = {
    *("", ".txt", ".json", ".xml", ".csv", ".db", ".bin", ".ply", ".npy", ".npz", ".md", ".html"),
    *(".log", ".gsyn", ".sfm", ".abc", ".psx", ".zip", ".py", ".sh", ".toml", ".yaml", ".yml"),
}
"""Endings of what lies beside photos and is none."""
CLUTTER = {"thumbs.db", "desktop.ini"}
FEW = 3
"""Pictures in a folder that are worth a word."""


def find_models(root: Path) -> list[Path]:
    """Folders in `root`, itself included, that hold a sparse model; those in sparse/ first.

    In sparse/ any file of a model counts, so that an error can name those that are missing;
    elsewhere there must be cameras and images.
    """
    found: dict[Path, Path] = {}  # links may lead to one folder on several ways
    for folder in sorted(_model_folders(root, DEPTH), key=lambda f: (len(f.parts), f)):
        if _holds_model(folder, root):
            found.setdefault(folder.resolve(), folder)
    return sorted(found.values(), key=lambda folder: _order(folder.relative_to(root)))


def in_sparse(root: Path, folder: Path) -> bool:
    """True if a model lies where COLMAP itself puts it: sparse/N or sparse/."""
    return folder.relative_to(root).parts[:1] == ("sparse",)


def _model_folders(folder: Path, depth: int) -> Iterator[Path]:
    yield folder
    for inner in folder.iterdir() if depth else ():
        last = LAST_FOLDER.fullmatch(inner.name) is not None
        if (last or MODEL_FOLDER.fullmatch(inner.name)) and inner.is_dir():
            yield from _model_folders(inner, 0 if last and depth == DEPTH else depth - 1)


def _holds_model(folder: Path, root: Path) -> bool:
    there = [has_model_file(folder, name) for name in MODEL_FILES]
    return any(there) if in_sparse(root, folder) else all(there[:2])


def has_model_file(folder: Path, name: str) -> bool:
    """True if a folder has cameras, images or points3D in COLMAP's binary or text."""
    return any((folder / f"{name}.{kind}").is_file() for kind in ("bin", "txt"))


def _order(relative: Path) -> tuple[bool, bool, int, list[tuple[int, str]]]:
    """Sort key of models: sparse/ first, those with distortion last, numbers by their value."""
    parts = relative.parts
    numbered = [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]
    # sparse/0 comes before what lies right in sparse/.
    return parts[:1] != ("sparse",), "distorted" in parts, -len(parts), numbered


def photo_folders(root: Path, model: Path) -> list[Path]:
    """Folders where photos of a model may lie, likely ones first: beside it, or above.

    Models of photos with distortion are of `input` where that is there. Not empty.
    """
    distorted = "distorted" in model.relative_to(root).parts
    names = PHOTO_FOLDERS[::-1] if distorted else PHOTO_FOLDERS
    above, found = [model, *model.parents], list[Path]()
    for folder in above[: above.index(root) + 1]:
        inner = [folder / name for name in names if (folder / name).is_dir()]
        found += [place for place in inner if any(place.iterdir())]
    beside = any(is_photo(path) for path in root.iterdir())
    return found or [root if beside else root / PHOTO_FOLDERS[0]]


def photo_folder(root: Path) -> Path:
    """The folder of photos without poses: images/ or input/ if photos are there, else `root`."""
    named = [root / name for name in PHOTO_FOLDERS if (root / name).is_dir()]
    return next((folder for folder in named if any(map(is_photo, files_in(folder)))), root)


def count_photos(root: Path) -> int:
    """Photos without poses; of those in subfolders of `root` itself, which may be scenes, none."""
    folder = photo_folder(root)
    return sum(map(is_photo, root.iterdir() if folder == root else files_in(folder)))


def unread_folders(root: Path, used: Iterable[Path]) -> tuple[str, ...]:
    """A phrase on folders right in `root` whose pictures nothing reads; none if there are none.

    Args:
        root: A scene's folder.
        used: Photos, masks and folders that are read.
    """
    inside = {path.relative_to(root).parts[:1] for path in used if path.is_relative_to(root)}
    pictures = {
        folder.name: sum(map(is_photo, folder.iterdir()))
        for folder in _folders(root)
        if (folder.name,) not in inside
    }
    found = [f"{name} ({count})" for name, count in pictures.items() if count >= FEW]
    masks = any(re.search("mask|matte|segm", name, re.I) for name in found)
    advice = ": masks are read from masks/, of their photos' names and sizes" if masks else ""
    return (f"folders of pictures that are not read: {listed(found)}{advice}",) if found else ()


def places_below(root: Path) -> list[str]:
    """Folders in `root`, at most two deep, that a scene or photos lie in, relative to it."""
    found = list[Path]()
    for folder in _folders(root):
        found += [folder] if _is_scene(folder) else filter(_is_scene, _folders(folder))
    return [place.relative_to(root).as_posix() for place in found]


def has_poses(folder: Path) -> bool:
    """True if a folder holds a transforms.json or a COLMAP model."""
    return (folder / "transforms.json").is_file() or any(find_models(folder))


def _is_scene(folder: Path) -> bool:
    return has_poses(folder) or count_photos(folder) >= FEW


def _folders(root: Path) -> list[Path]:
    """Folders right in another, hidden ones left out, by name."""
    return sorted(p for p in root.iterdir() if p.is_dir() and not p.name.startswith("."))


class PhotoIndex:
    """Photos by the names that a model has for them, found also where a copy changed the names.

    A name may differ in case (a move from Windows), in Unicode form (one from a Mac), in the
    direction of its slashes, or begin with the name of the folder itself.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._near: list[tuple[Path, Path]] = []
        self._folded: dict[Path, dict[str, list[Path]]] = {}

    def find(self, place: Path) -> Path:
        """The file at a place inside the folder or near it; the place itself if there is none."""
        if place.is_file():
            return place
        parts = place.relative_to(self.folder).parts
        inner = [self.folder.joinpath(*parts[1:])] if parts[0] == self.folder.name else []
        for near in (place, *inner):
            same = self._names(near.parent).get(folded(near.name), [])
            file = near if near.is_file() else same[0] if len(same) == 1 else None
            if file is not None:
                self._near.append((place, file))
                return file
        return place

    @property
    def notes(self) -> tuple[str, ...]:
        """A sentence on the files that were found under other names than asked for."""
        if not self._near:
            return ()
        wanted, found = (path.relative_to(self.folder).as_posix() for path in self._near[0])
        return (
            f"{len(self._near)} photos have names that differ from the listed ones in letter case, "
            f"Unicode form or folder, as {found!a} for {wanted!a}",
        )

    def _names(self, folder: Path) -> dict[str, list[Path]]:
        if folder not in self._folded:
            names: dict[str, list[Path]] = {}
            for path in folder.iterdir() if folder.is_dir() else ():
                names.setdefault(folded(path.name), []).append(path)
            self._folded[folder] = names
        return self._folded[folder]


def folded(name: str) -> str:
    """A name without what file systems differ in: case and Unicode form."""
    return unicodedata.normalize("NFC", name).casefold()


@dataclass(frozen=True)
class UnusedFiles:
    """Files among the photos that no view is of.

    Attributes:
        photos: Names of photos, sorted.
        endings: Numbers of other files by ending, see `endings_of`.
    """

    photos: tuple[str, ...]
    endings: dict[str, int]


def unused_files(
    root: Path, folders: Iterable[Path], used: Iterable[Path], names: Path | None = None
) -> UnusedFiles:
    """Files among the photos of a scene that are not used.

    Args:
        root: The scene's folder; photos right in it count if it is among `folders`.
        folders: Folders of photos, searched with their subfolders, except hidden ones and masks.
        used: Photos in use.
        names: Names of photos are relative to this; None: to `root`.
    """
    places, known = set(folders), set(used)
    files = [path for folder in places - {root} for path in files_in(folder)]
    own = [path for path in root.iterdir() if path.is_file()]
    photos = without_masks([*files, *(own if root in places else ())])
    named = sorted(path.relative_to(names or root).as_posix() for path in photos - known)
    return UnusedFiles(tuple(named), endings_of({*files, *own} - known, root))


def without_masks(paths: Iterable[Path]) -> set[Path]:
    """The photos among files, without those that are masks of others of them by their names."""
    photos = {path for path in paths if is_photo(path)}
    stems = {path.with_suffix("") for path in photos} | photos
    return {path for path in photos if not _stem_of_mask(path) & stems}


def _stem_of_mask(path: Path) -> set[Path]:
    """The photo, without its ending or with it, that a file is the mask of by its name."""
    ends = [end for end in MASK_ENDS if path.stem.endswith(end) and path.stem != end]
    return {path.with_name(path.stem.removesuffix(end)) for end in ends}


def endings_of(paths: Iterable[Path], root: Path | None) -> dict[str, int]:
    """Numbers of files that are no photos by ending, lower case.

    Args:
        paths: The files.
        root: A scene's folder: of the files right in it only images count.
    """
    endings = Counter[str]()
    for path in paths:
        ending = path.suffix.lower()
        beside = path.parent == root and ending in NO_PICTURES
        if not (is_photo(path) or beside or path.name.lower() in CLUTTER):
            endings[ending or "(no ending)"] += 1
    return dict(endings)


def files_in(folder: Path) -> Iterator[Path]:
    """Files in a folder and its subfolders, but for hidden ones and masks."""
    for place, inner, names in os.walk(folder):
        inner[:] = [n for n in inner if not n.startswith(".") and n not in MASK_FOLDERS]
        yield from (Path(place) / name for name in names if not name.startswith("."))
