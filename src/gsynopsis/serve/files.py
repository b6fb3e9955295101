"""The scenes below one root, and nothing else: names to paths, addresses."""

import os
import stat
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from gsynopsis.errors import InputError

ENDING = ".gsyn"


@dataclass(frozen=True)
class Root:
    """Root of what may be served: the scenes of a folder, or one of them.

    Attributes:
        folder: Resolved folder.
        only: Name of the one file in it that is served, empty for all.
    """

    folder: Path
    only: str = ""

    def find(self, name: str) -> Path | None:
        """The scene of that name, without links; None if there is none that may be served.

        Hidden names, `..`, and links that lead to something hidden, out of the folder, or to what
        is no scene, find nothing.
        """
        if "\0" in name or not _shown(name) or (self.only and name != self.only):
            return None
        try:
            path = (self.folder / name).resolve(strict=True)
            regular = stat.S_ISREG(path.stat().st_mode)
        except (OSError, RuntimeError, ValueError):
            return None
        if not regular or not path.is_relative_to(self.folder):
            return None
        return path if _shown(path.relative_to(self.folder).as_posix()) else None

    def names(self) -> list[str]:
        """All scenes that may be served, sorted; with an odd byte for each odd byte."""
        found = [self.only] if self.only else self._walk()
        return sorted(name for name in found if self.find(name) is not None)

    def _walk(self) -> list[str]:
        names: list[str] = []
        for folder, folders, files in os.walk(self.folder):
            folders[:] = [name for name in folders if not name.startswith(".")]
            names += [
                (Path(folder) / name).relative_to(self.folder).as_posix()
                for name in files
                if _shown(name)
            ]
        return names


def _shown(name: str) -> bool:
    """A scene's name, no part of which is hidden, empty or `..`."""
    return name.endswith(ENDING) and not any(
        not part or part.startswith(".") for part in name.split("/")
    )


def root_of(path: Path) -> Root:
    """The root for a folder of scenes or a single one.

    Raises:
        InputError: there is neither.
    """
    expected = f"a folder or a {ENDING} file"
    try:
        real = path.resolve(strict=True)
    except (OSError, RuntimeError) as error:
        found = getattr(error, "strerror", "") or error
        raise InputError(path, found=found, expected=expected) from error
    if real.is_dir():
        return Root(real)
    root = Root(real.parent, real.name)
    if root.find(real.name) is None:
        found = "a hidden file" if real.name.startswith(".") else "another file"
        raise InputError(path, found=found, expected=expected)
    return root


def address_of(name: str) -> str:
    """A name as an address relative to the root, byte for byte."""
    return quote(os.fsencode(name))


def shown_name(name: str) -> str:
    """A name as text for people; bytes that are no UTF-8 show as �."""
    return os.fsencode(name).decode("utf-8", "replace")
