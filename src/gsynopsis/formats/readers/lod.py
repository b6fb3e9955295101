"""Streamed SOG, version 1: a `lod-meta.json` with a tree of pieces of SOGs. LOD 0 is the finest."""

from pathlib import Path
from typing import Any

import numpy as np

from gsynopsis.errors import InputError
from gsynopsis.formats.readers.base import SplatFile, check_count
from gsynopsis.formats.readers.sog import META_MAX, in_folder, parsed, read_pictures
from gsynopsis.records import HARMONICS, PlainGaussians

NAME = "lod-meta.json"
LODS_MAX = 16
NODES_MAX = 1 << 20


def read_lods(path: Path) -> SplatFile:
    """The Gaussians of all levels of a streamed SOG.

    Raises:
        InputError: it is damaged, of another version or too large.
    """
    read = in_folder(path.parent)
    meta = parsed(read(path.name, META_MAX * 16), path)
    try:
        if meta.get("version", 1) != 1:
            raise InputError(path, "version", found=meta["version"], expected=1)
        count = meta["lodLevels"]
        if not isinstance(count, int) or not 1 <= count <= LODS_MAX:
            raise InputError(path, "lodLevels", found=count, expected=f"1 to {LODS_MAX}")
        pieces = _pieces(meta, count)
        total = sum(length for spans in pieces for _, _, length in spans)
        check_count(total, path)
        levels: list[PlainGaussians] = []
        flags: list[bool] = []
        units: dict[int, PlainGaussians] = {}
        for spans in reversed(pieces):
            for number in sorted({number for number, _, _ in spans} - set(units)):
                found, flag = read_pictures(read, meta["filenames"][number], path)
                units[number] = found
                flags.append(flag)
            if spans:
                levels.append(joined([_span(units[n], o, c, path) for n, o, c in spans]))
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        found = f"{type(error).__name__}: {error}"
        raise InputError(path, found=found, expected="that of a streamed SOG") from error
    return SplatFile(tuple(levels), any(flags), kind="streamed SOG")


def _pieces(meta: dict[str, Any], count: int) -> list[list[tuple[int, int, int]]]:
    """File, offset and length of each piece, by LOD."""
    found: list[list[tuple[int, int, int]]] = [[] for _ in range(count)]
    nodes, seen = [meta["tree"]], 0
    while nodes:
        node = nodes.pop()
        seen += 1
        if seen > NODES_MAX:
            raise ValueError(f"more than {NODES_MAX} nodes")
        nodes += node.get("children") or []
        for key, piece in (node.get("lods") or {}).items():
            place = tuple(piece[name] for name in ("file", "offset", "count"))
            if not all(isinstance(value, int) and value >= 0 for value in place):
                raise ValueError(f"a piece at {place}")
            found[int(key)].append(place)
    return [sorted(pieces) for pieces in found]


def _span(unit: PlainGaussians, offset: int, count: int, path: Path) -> PlainGaussians:
    if offset + count > len(unit):
        found = f"{offset} and {count} more"
        raise InputError(path, "piece", found=found, expected=f"at most {len(unit)} in its file")
    rows = slice(offset, offset + count)
    return PlainGaussians(
        unit.means[rows],
        unit.log_scales[rows],
        unit.quaternions[rows],
        unit.logits[rows],
        unit.sh[rows],
    )


def joined(parts: list[PlainGaussians]) -> PlainGaussians:
    """All of some Gaussians; harmonics that some lack are 0."""
    width = 1 + max(HARMONICS[part.degree] for part in parts) // 3
    sh = [np.pad(p.sh, ((0, 0), (0, width - p.sh.shape[1]), (0, 0))) for p in parts]
    return PlainGaussians(
        np.concatenate([p.means for p in parts]),
        np.concatenate([p.log_scales for p in parts]),
        np.concatenate([p.quaternions for p in parts]),
        np.concatenate([p.logits for p in parts]),
        np.concatenate(sh),
    )
