"""The scenes below one root, and nothing else: names to open files, addresses."""

import errno
import hashlib
import os
import stat
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from gsynopsis.errors import InputError

ENDING = ".gsyn"
HEAD = 4096
"""Bytes at a file's beginning; a scene's have the checksums of all its parts."""
FULL = {errno.EMFILE, errno.ENFILE}


@dataclass(frozen=True)
class OpenFile:
    """One version of a file: whatever takes the name meanwhile, these are its bytes.

    Attributes:
        handle: Descriptor; `close` gives it back.
        size: Bytes.
        modified: Nanoseconds since the epoch.
        tag: A strong ETag.
    """

    handle: int
    size: int
    modified: int
    tag: str

    def read(self, start: int, stop: int) -> bytes:
        """The bytes from `start` to `stop`, fewer at the end of the file; blocks."""
        return os.pread(self.handle, stop - start, start)

    def unchanged(self) -> bool:
        """Nobody has written into the file itself since it was opened."""
        state = os.fstat(self.handle)
        return (state.st_size, state.st_mtime_ns) == (self.size, self.modified)

    def close(self) -> None:
        """Give the descriptor back."""
        os.close(self.handle)


@dataclass(frozen=True)
class Root:
    """What may be served: the scenes of a folder, or one of them.

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

    def open(self, name: str) -> OpenFile | None:
        """The scene of that name, None if there is none that may be served.

        Raises:
            OSError: EMFILE or ENFILE, if no file can be opened at the moment.
        """
        path = self.find(name)
        if path is None:
            return None
        try:
            # The path has no links any more; should one stand there by now, it is not followed.
            flags = os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
            handle = os.open(path, flags)
        except OSError as error:
            if error.errno in FULL:
                raise
            return None
        try:
            state = os.fstat(handle)
            head = os.pread(handle, HEAD, 0) if stat.S_ISREG(state.st_mode) else None
        except OSError:
            head, state = None, None
        if head is None or state is None:
            os.close(handle)
            return None
        return OpenFile(handle, state.st_size, state.st_mtime_ns, tag_of(state, head))

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


def tag_of(state: os.stat_result, head: bytes) -> str:
    """A strong ETag: another one whenever the file was replaced or written.

    The clock of a file system stands still for milliseconds, and it gives a number to the next
    file at once: so the file's first bytes count too.
    """
    text = f"{state.st_ino}-{state.st_mtime_ns}-{state.st_size}-".encode()
    return f'"{hashlib.sha256(text + head).hexdigest()[:24]}"'


def address_of(name: str) -> str:
    """A name as an address relative to the root, byte for byte."""
    return quote(os.fsencode(name))


def shown_name(name: str) -> str:
    """A name as text for people; bytes that are no UTF-8 show as �."""
    return os.fsencode(name).decode("utf-8", "replace")
