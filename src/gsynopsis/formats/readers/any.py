"""A splat file of any format, recognised by its first bytes, not by its name."""

import re
from pathlib import Path

import numpy as np

from gsynopsis.errors import InputError
from gsynopsis.files import open_regular
from gsynopsis.formats.readers.base import SplatFile
from gsynopsis.formats.readers.glb import MAGIC as GLB
from gsynopsis.formats.readers.glb import read_glb
from gsynopsis.formats.readers.ksplat import read_ksplat
from gsynopsis.formats.readers.lod import NAME, lods_of
from gsynopsis.formats.readers.opening import Folder
from gsynopsis.formats.readers.ply import read_ply
from gsynopsis.formats.readers.sog import META, bundled, sog_of
from gsynopsis.formats.readers.splat import read_splat
from gsynopsis.formats.readers.spz import GZIP, MAGIC, read_spz
from gsynopsis.formats.readers.usd import BEGINS as USD
from gsynopsis.formats.readers.usd import read_usd

EXPECTED = "a PLY, SPZ, SOG, GLB, USD, .splat or .ksplat file, a meta.json or a lod-meta.json"
NAMED = {".splat": read_splat, ".ksplat": read_ksplat}
"""Formats that do not begin with a sign of their own, by the ending."""
LOD = re.compile(r"(.*_lod)(\d+)(\.ply)", re.ASCII)
"""Names of a family that Brush writes: 0 is the finest."""


def read_splats(path: Path) -> SplatFile:
    """The Gaussians of a file; of a folder those of its `lod-meta.json` or `meta.json`.

    Of a family NAME_lod0.ply, NAME_lod1.ply, … any member stands for all.

    Raises:
        InputError: there is none, or it is of no known format, damaged or too large.
        MissingExtraError: it takes a package that is not installed.
    """
    if path.is_dir():
        inner = [path / name for name in (NAME, META) if (path / name).is_file()]
        if not inner:
            raise InputError(path, found=f"a folder without {NAME} or {META}", expected=EXPECTED)
        path = inner[0]
    if not path.exists():
        raise InputError(path, found="no such file", expected=EXPECTED)
    # What values cannot be is found when they are checked, and told in one line.
    with np.errstate(all="ignore"):
        try:
            return _read(path)
        except OSError as error:
            raise InputError(path, found=error.strerror or error, expected=EXPECTED) from error


def is_splats(path: Path) -> bool:
    """True if `read_splats` has a reader for what a path begins with; no more of it is read.

    A folder counts if it has a `lod-meta.json` or `meta.json`.
    """
    if path.is_dir():
        return any((path / name).is_file() for name in (NAME, META))
    if not path.is_file():
        return False
    try:
        with open_regular(path) as file:
            start = file.read(4)
    except (OSError, InputError):
        return False
    known = start.startswith((b"ply", MAGIC, GZIP, GLB, b"PK")) or start in USD
    return known or path.name in (NAME, META) or path.suffix.lower() in NAMED


def _read(path: Path) -> SplatFile:
    with open_regular(path) as file:
        start = file.read(4)
    if start.startswith(b"ply"):
        return _read_family(path)
    if start.startswith((MAGIC, GZIP)):
        return read_spz(path)
    if start == GLB:
        return read_glb(path)
    if start.startswith(b"PK"):
        return read_usd(path) if path.suffix.lower() == ".usdz" else _read_bundle(path)
    if start in USD:
        return read_usd(path)
    if path.suffix == ".json":
        of = lods_of if "lod" in path.name else sog_of
        return of(Folder(path.parent), path.name, path)
    if reader := NAMED.get(path.suffix.lower()):
        return reader(path)
    found = f"a file that begins with {start!r}" if start else "an empty file"
    raise InputError(path, found=found, expected=EXPECTED)


def _read_bundle(path: Path) -> SplatFile:
    """A zip: a SOG, or a streamed one with all that belongs to it."""
    with open_regular(path) as file, bundled(file, path) as bundle:
        if NAME in bundle.bundle.NameToInfo:
            return lods_of(bundle, NAME, path)
        return sog_of(bundle, META, path)


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
    levels = tuple(level for file in reversed(members) for level in file.levels)
    notes = tuple(
        f"lod {number}: {note}" for number, file in enumerate(members) for note in file.notes
    )
    first = members[0]
    return SplatFile(
        levels, first.antialiased, first.up, f"{len(levels)} PLY", 0, notes, first.up_said
    )
