"""A file of Gaussians in whatever format: told apart by what it begins with, not by its name."""

from pathlib import Path

from gsynopsis.errors import InputError
from gsynopsis.formats.readers.base import SplatFile
from gsynopsis.formats.readers.ply import read_ply

EXPECTED = "a PLY file"


def read_splats(path: Path) -> SplatFile:
    """The Gaussians of a file.

    Raises:
        InputError: there is none, or it is of no known format, damaged or too large.
    """
    if not path.is_file():
        found = "a folder" if path.is_dir() else "no such file"
        raise InputError(path, found=found, expected=EXPECTED)
    try:
        with path.open("rb") as file:
            start = file.read(4)
        if start.startswith(b"ply"):
            return read_ply(path)
    except OSError as error:
        raise InputError(path, found=error.strerror or error, expected=EXPECTED) from error
    raise InputError(path, found=f"a file that begins with {start!r}", expected=EXPECTED)
