"""Photos that a transforms.json names: with or without ending, and moved since it was written."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from gsynopsis.scene.search import PhotoIndex
from gsynopsis.scene.views import inner_place, place_of

SUFFIXES = (".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG")
MOVED_MOST = 200
"""Most characters of the name of a photo that is looked for elsewhere; file systems take 255."""


class ListedPhotos:
    """Photos of one folder by the names of a list, found in images/ or beside it if moved."""

    def __init__(self, root: Path, named: Sequence[str]) -> None:
        """`named` are all names of the list."""
        self.root, self.named = root, named
        self._index, self._moved = PhotoIndex(root), dict[str, Path]()
        self._count = Counter(map(_last_part, named))

    def path(self, listing: Path, name: str) -> Path:
        """The photo of a name; a place without a file if there is none.

        Raises:
            SceneError: The name leads out of the folder, and no photo of such a name is in it.
        """
        place = inner_place(self.root, name)
        path = place and self._found(place)
        if path is not None and path.is_file():
            return path
        if (moved := self._elsewhere(name)) is not None:
            self._moved[name] = moved
            return moved
        if path is not None:
            return path
        # Where other photos were moved into the folder, one that was not is lost, no more.
        outside = (other for other in self.named if inner_place(self.root, other) is None)
        if not any(map(self._elsewhere, outside)):
            return place_of(listing, self.root, name)
        return self.root / "images" / (_last_part(name)[:MOVED_MOST] or "?")

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on photos that were found under other names, or elsewhere."""
        if not self._moved:
            return self._index.notes
        name, path = next(iter(self._moved.items()))
        where = path.relative_to(self.root).as_posix()
        told = (
            f"{len(self._moved)} photos are not where the file says and were found by their names"
        )
        return (*self._index.notes, f"{told}, as {where!a} for {name!a}")

    def _found(self, place: Path) -> Path:
        path = self._index.find(place)
        if path.is_file():
            return path
        # Blender leaves the extension out; a name may have dots of its own.
        longer = [path.with_name(path.name + suffix) for suffix in SUFFIXES]
        return next((p for p in longer if p.is_file()), path)

    def _elsewhere(self, name: str) -> Path | None:
        """The photo of a name that no other frame has, in images/ or beside the file, if any."""
        last = _last_part(name)
        if self._count[last] != 1 or last in {"", ".", ".."} or len(last) > MOVED_MOST:
            return None
        for folder in (self.root / "images", self.root):
            path = self._found(folder / last)
            if path.is_file():
                return path
        return None


def _last_part(name: str) -> str:
    return name.replace("\\", "/").rpartition("/")[2]
