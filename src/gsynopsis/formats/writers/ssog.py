"""Streamed SOG, version 1: `lod-meta.json` and a SOG for each region and level.

There LOD 0 is the finest: our levels are its LODs, counted from the other end.
"""

import json
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gsynopsis.formats.readers.base import rows_of
from gsynopsis.formats.writers.sog import META, sog_files
from gsynopsis.records import PlainGaussians

LEAF = 1 << 16
"""Most Gaussians of the finest level in a region (ours)."""
INDEX = "lod-meta.json"
REACH = 3.0
"""Standard deviations that a region's bounds hold of each Gaussian."""
Rows = tuple[NDArray[np.int64], ...]
"""Rows of a region, by LOD."""


def ssog_files(
    levels: Sequence[PlainGaussians],
    errors: Sequence[float] | None = None,
    *,
    antialiased: bool = False,
) -> dict[str, bytes]:
    """All files of the folder by name.

    Args:
        levels: Coarsest first, as ours; the finest not empty.
        errors: Of each level, any unit, ≥ 0, falling; None: programs guess it from counts.
        antialiased: Gaussians are to be drawn so.
    """
    lods = [*reversed(levels)]
    files: dict[str, bytes] = {}
    names: list[str] = []

    def leaf(rows: Rows) -> dict[str, Any]:
        found: dict[str, dict[str, int]] = {}
        for lod, chosen in enumerate(rows):
            if not len(chosen):
                continue
            name = f"{lod}_{sum(n.startswith(f'{lod}_') for n in names)}"
            part = sog_files(rows_of(lods[lod], chosen), antialiased=antialiased)
            files.update({f"{name}/{entry}": data for entry, data in part.items()})
            found[str(lod)] = {"file": len(names), "offset": 0, "count": len(chosen)}
            names.append(f"{name}/{META}")
        return {"bound": _bounds(lods, rows), "lods": found}

    everything = tuple(np.arange(len(lod)) for lod in lods)
    tree = _node(lods, everything, leaf)
    if errors is not None:
        _put_errors(tree, [*reversed(errors)])
    counts = [len(lod) for lod in lods]
    meta = {
        "version": 1,
        "asset": {"generator": "gsynopsis"},
        "count": sum(counts),
        "counts": counts,
        "lodLevels": len(lods),
        "lodErrors": errors is not None,
        "filenames": names,
        "tree": tree,
    }
    return {INDEX: json.dumps(meta).encode(), **files}


def _node(
    lods: Sequence[PlainGaussians], rows: Rows, leaf: Callable[[Rows], dict[str, Any]]
) -> dict[str, Any]:
    """A region, halved at the median of its longest side while its finest LOD is too large."""
    finest = lods[0].means[rows[0]]
    if len(finest) <= LEAF:
        return leaf(rows)
    axis = int(np.ptp(finest, axis=0).argmax())
    middle = np.median(finest[:, axis])
    low = [lod.means[chosen, axis] < middle for lod, chosen in zip(lods, rows, strict=True)]
    halves = (
        tuple(chosen[side] for chosen, side in zip(rows, low, strict=True)),
        tuple(chosen[~side] for chosen, side in zip(rows, low, strict=True)),
    )
    if not all(len(half[0]) for half in halves):
        return leaf(rows)
    return {
        "bound": _bounds(lods, rows),
        "children": [_node(lods, half, leaf) for half in halves],
    }


def _bounds(lods: Sequence[PlainGaussians], rows: Rows) -> dict[str, list[float]]:
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for lod, chosen in zip(lods, rows, strict=True):
        if len(chosen):
            reach = REACH * np.exp(lod.log_scales[chosen].max(axis=1, keepdims=True))
            low = np.minimum(low, (lod.means[chosen] - reach).min(axis=0))
            high = np.maximum(high, (lod.means[chosen] + reach).max(axis=0))
    return {"min": low.tolist(), "max": high.tolist()}


def _put_errors(node: dict[str, Any], errors: list[float]) -> None:
    """Every leaf has those of the whole; they never fall from one LOD to the next coarser."""
    for child in node.get("children", ()):
        _put_errors(child, errors)
    if "lods" in node:
        rising = np.maximum.accumulate(errors)
        node["errors"] = [float(e) if str(k) in node["lods"] else 0.0 for k, e in enumerate(rising)]
