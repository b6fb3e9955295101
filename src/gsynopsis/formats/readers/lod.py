"""Streamed SOG, version 1: a `lod-meta.json` with a tree of pieces of SOGs. LOD 0 is the finest."""

from collections import Counter
from pathlib import Path
from typing import Any

from gsynopsis.errors import InputError
from gsynopsis.formats.readers.base import (
    SplatFile,
    check_count,
    check_ratio,
    cleaned,
    joined,
    rows_of,
    shown,
)
from gsynopsis.formats.readers.opening import Files, parsed
from gsynopsis.formats.readers.sog import FOREIGN, read_pictures
from gsynopsis.records import PlainGaussians

NAME = "lod-meta.json"
NAME_MAX = 1 << 24
"""Bytes of a `lod-meta.json`."""
LODS_MAX = 16
NODES_MAX = 1 << 20
Piece = tuple[int, int, int]
"""Number of a file, first Gaussian there, and how many."""


def lods_of(files: Files, name: str, path: Path) -> SplatFile:
    """The Gaussians of a streamed SOG; each level begins with the environment, if there is one.

    Args:
        files: Where its files are.
        name: Of its `lod-meta.json`.
        path: What messages call it.

    Raises:
        InputError: it is damaged, of another version or too large.
    """
    meta = parsed(files.read(name, NAME_MAX), path)
    try:
        if meta.get("version", 1) != 1:
            raise InputError(path, "version", found=shown(meta["version"]), expected=1)
        count = meta["lodLevels"]
        if type(count) is not int or not 1 <= count <= LODS_MAX:
            raise InputError(path, "lodLevels", found=shown(count), expected=f"1 to {LODS_MAX}")
        pieces = _pieces(meta, count)
        check_count(sum(length for spans in pieces for _, _, length in spans), path)
        units = _Units(files, meta["filenames"], path)
        around = meta.get("environment")
        first = [units.named(around)] if around else []
        parts = [[*first, *units.pieces(spans)] for spans in reversed(pieces) if spans]
        check_ratio(sum(len(part) for level in parts for part in level), files.stored, path)
        levels = tuple(joined(level) for level in parts)
    except FOREIGN as error:
        found = shown(f"{type(error).__name__}: {error}")
        raise InputError(path, found=found, expected="that of a streamed SOG") from error
    same = len(first[0]) if first else 0
    notes = (f"the environment, {same:,} splats, is part of every level",) if same else ()
    kind = "streamed SOG"
    file = SplatFile(levels, units.antialiased, kind=kind, environment=same, notes=notes)
    return cleaned(file, path)


class _Units:
    """The SOGs of a streamed one, each read once."""

    def __init__(self, files: Files, names: list[str], path: Path) -> None:
        self.files, self.names, self.path = files, names, path
        self.antialiased = False
        self._read: dict[str, PlainGaussians] = {}

    def named(self, name: str) -> PlainGaussians:
        """All of a SOG."""
        if name not in self._read:
            before = sum(map(len, self._read.values()))
            self._read[name], flag = read_pictures(self.files, name, self.path, before)
            self.antialiased |= flag
        return self._read[name]

    def pieces(self, spans: list[Piece]) -> list[PlainGaussians]:
        """Gaussians of one level.

        Raises:
            InputError: a SOG has fewer, or the level has some twice.
        """
        found: list[PlainGaussians] = []
        used = Counter[str]()
        for number, offset, count in spans:
            name = self.names[number]
            unit = self.named(name)
            used[name] += count
            if offset + count > len(unit) or used[name] > len(unit):
                text = f"{count:,} splats from {offset:,} on in {shown(name)}"
                expected = f"each once of the {len(unit):,} that are there"
                raise InputError(self.path, "piece", found=text, expected=expected)
            found.append(rows_of(unit, slice(offset, offset + count)))
        return found


def _pieces(meta: dict[str, Any], count: int) -> list[list[Piece]]:
    """Pieces of each LOD, by file and offset."""
    found: list[list[Piece]] = [[] for _ in range(count)]
    nodes, seen = [meta["tree"]], 0
    while nodes:
        node = nodes.pop()
        seen += 1
        if seen > NODES_MAX:
            raise ValueError(f"more than {NODES_MAX} nodes")
        nodes += node.get("children") or []
        for key, piece in (node.get("lods") or {}).items():
            file, offset, length = (piece[name] for name in ("file", "offset", "count"))
            if not all(type(value) is int and value >= 0 for value in (file, offset, length)):
                raise ValueError(f"a piece at {shown((file, offset, length))}")
            if not (key.isascii() and key.isdigit() and len(key) < 3 and int(key) < count):
                raise ValueError(f"LOD {shown(key)} of {count}")
            if length:
                found[int(key)].append((file, offset, length))
    return [sorted(pieces) for pieces in found]
