"""A file of Gaussians in whatever format: told apart by what it begins with, not by its name."""

import re
from pathlib import Path

from gsynopsis.errors import InputError
from gsynopsis.formats.readers.base import SplatFile
from gsynopsis.formats.readers.lod import joined, read_lods
from gsynopsis.formats.readers.ply import read_ply
from gsynopsis.formats.readers.sog import META, read_sog
from gsynopsis.formats.readers.spz import GZIP, MAGIC, read_spz

EXPECTED = "a PLY, SPZ or SOG file, a meta.json or a lod-meta.json"
LOD = re.compile(r"(.*_lod)(\d+)(\.ply)")
"""Names of a family that Brush writes: 0 is the finest."""


def read_splats(path: Path) -> SplatFile:
    """The Gaussians of a file; of a folder those of its `lod-meta.json` or `meta.json`.

    Of a family NAME_lod0.ply, NAME_lod1.ply, … any member stands for all.

    Raises:
        InputError: there is none, or it is of no known format, damaged or too large.
        MissingExtraError: it takes a package that is not installed.
    """
    if path.is_dir():
        inner = [path / name for name in ("lod-meta.json", META) if (path / name).is_file()]
        path = inner[0] if inner else path
    if not path.is_file():
        found = "a folder without one" if path.is_dir() else "no such file"
        raise InputError(path, found=found, expected=EXPECTED)
    try:
        return _read(path)
    except OSError as error:
        raise InputError(path, found=error.strerror or error, expected=EXPECTED) from error


def _read(path: Path) -> SplatFile:
    with path.open("rb") as file:
        start = file.read(4)
    if start.startswith(b"ply"):
        return _read_family(path)
    if start.startswith((MAGIC, GZIP)):
        return read_spz(path)
    if start.startswith(b"PK"):
        return read_sog(path)
    if path.suffix == ".json":
        return read_lods(path) if "lod" in path.name else read_sog(path)
    raise InputError(path, found=f"a file that begins with {start!r}", expected=EXPECTED)


def _read_family(path: Path) -> SplatFile:
    """A PLY with its coarser and finer ones."""
    name = LOD.fullmatch(path.name)
    if name is None:
        return read_ply(path)
    members: list[SplatFile] = []
    while (member := path.with_name(f"{name[1]}{len(members)}{name[3]}")).is_file():
        members.append(read_ply(member))
    if not members:
        return read_ply(path)
    levels = tuple(joined([level]) for file in reversed(members) for level in file.levels)
    return SplatFile(levels, members[0].antialiased, members[0].up, f"{len(levels)} PLY")
