"""Sizes of each level in four accountings (methods.md §1.14, §3.6), all in bytes.

The paper stores float32 rows with all K offsets of each anchor and sums the deltas; it counts
DEFLATE of those rows. Beside it stands what our own files take.
"""

import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import msgspec
import numpy as np

from gsynopsis.container.writer import encode_with_account
from gsynopsis.records import TRAINED_NOTE, Level, LevelSet, harmonics_of, positions

PAPER_DEFLATE_LEVEL = 6
Size = Annotated[int, msgspec.Meta(ge=0, lt=2**50)]
"""Bytes."""


@dataclass(frozen=True)
class LevelSizes:
    """Sizes of one level. A client holds `bytes_…` at this level and fetches `delta_…` for it.

    Attributes:
        level: 0 is the coarsest.
        anchors: Anchors of the level.
        slots: Live slots of the level.
        bytes_paper: Rows of float32 with all K offsets, plus mask bits, grids, codebooks, networks.
        bytes_deflate: The same, each delta as one zlib stream of level 6: the paper's accounting.
        bytes_raw: Our file with coding `raw`: live offsets only, header and checksums included.
            These three are of the values that training left, float32 that nothing rounded.
        bytes_compact: Our file with coding `compact`.
        delta_paper: What the level adds to `bytes_paper`.
        delta_deflate: What the level adds to `bytes_deflate`.
        delta_raw: What the level adds to `bytes_raw`.
        delta_compact: What the level adds to `bytes_compact`.
    """

    level: int
    anchors: int
    slots: int
    bytes_paper: int
    bytes_deflate: int
    bytes_raw: int
    bytes_compact: int
    delta_paper: int
    delta_deflate: int
    delta_raw: int
    delta_compact: int


def measure(levels: LevelSet) -> list[LevelSizes]:
    """Sizes of all levels, coarsest first; nothing is written.

    Rounded values deflate far better than those of training. So what a file's
    note says of the latter counts, where there is one.
    """
    compact = encode_with_account(levels, "compact")[1]
    trained = trained_note(levels.meta, len(levels.levels)) or trained_bytes(levels)
    rows: list[LevelSizes] = []
    total = np.zeros(4, np.int64)
    for number, level in enumerate(levels.levels):
        delta = [*trained[number], compact.delta(number)]
        total += delta
        numbers = [number, level.anchors, level.live, *total.tolist(), *delta]
        rows.append(LevelSizes(*numbers))
    return rows


def trained_bytes(levels: LevelSet) -> list[list[int]]:
    """Bytes that each level adds in float32: the paper's rows, the same deflated, our raw file."""
    raw = encode_with_account(levels, "raw")[1]
    found: list[list[int]] = []
    for number in range(len(levels.levels)):
        paper = paper_rows(levels, number)
        found.append(
            [len(paper), len(zlib.compress(paper, PAPER_DEFLATE_LEVEL)), raw.delta(number)]
        )
    return found


def trained_text(trained: Sequence[Sequence[int]]) -> str:
    """The note of a file that `trained_note` reads."""
    return json.dumps(trained, separators=(",", ":"))


def trained_note(meta: Mapping[str, str], levels: int) -> list[list[int]] | None:
    """Sizes before rounding, from the file's note; None without a valid note.

    Args:
        meta: Notes of the manifest.
        levels: How many are held; a prefix has the note of the whole file.
    """
    try:
        found = msgspec.json.decode(meta[TRAINED_NOTE], type=list[tuple[Size, Size, Size]])
    except (KeyError, msgspec.DecodeError):
        return None
    return [list(row) for row in found[:levels]] if len(found) >= levels else None


def paper_rows(levels: LevelSet, number: int) -> bytes:
    """Bytes that a level adds in the paper's layout: rows of new anchors, then the shared parts.

    A row is position, log-scales and all K offsets in float32, the codebook index and any
    residual. New mask bits are counted too, though peers leave them out. A splat's row is position,
    log-scales, rotation, opacity and colours: 58 float32 with harmonics of degree 3.
    """
    shared, level = levels.shared, levels.levels[number]
    parent: Level | None = levels.levels[number - 1] if number else None
    start = parent.anchors if parent else 0
    grids = parent.grids if parent else 0
    rows = slice(start, level.anchors)
    if shared.degree is not None:
        harmonics = harmonics_of(shared, levels.levels)
        values = positions(levels.frame, shared.lattice), shared.log_scales, shared.residual
        row = np.concatenate([part[rows] for part in (*values, harmonics)], axis=1)
        return row.astype("<f4").tobytes() + level.gain.astype("<f4").tobytes()
    floats = np.concatenate(
        [
            positions(levels.frame, shared.lattice[rows]),
            shared.log_scales[rows],
            shared.offsets[rows].reshape(level.anchors - start, 3 * shared.slots),
            shared.residual[rows],
        ],
        axis=1,
    ).astype("<f4")
    columns = [floats.view(np.uint8), shared.codes[rows, None]]
    if not len(shared.codes):
        columns.pop()
    parts = [np.concatenate(columns, axis=1).tobytes()]
    parts.append(np.packbits(level.mask[~levels.before(number)], bitorder="little").tobytes())
    parts += [grid.astype("<f4").tobytes() for grid in shared.grids[grids : level.grids]]
    parts.append(level.codebook.astype("<f4").tobytes())
    networks = levels.own_networks(number)
    parts += [weights.astype("<f4").tobytes() for weights in networks.values()]
    parts.append(level.gain.astype("<f4").tobytes())
    return b"".join(parts)
