"""The committed test vectors: small files of every shape and coding, for any decoder.

`python -m tests.container.vectors` writes them again, with what `drawings` makes of them; the bytes
depend on zlib, so it is for a change of the format only. `digests.json` holds SHA-256 sums of the
decoded values, see `digest`.
"""

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from gsynopsis.container import decode
from gsynopsis.container.coding import CodingPlan, Quantizer
from gsynopsis.container.layout import CodingId
from gsynopsis.container.pages import PAGE_BLOCKS
from gsynopsis.container.writer import encode_with_account
from gsynopsis.records import Float32, Frame, Level, LevelSet
from tests.level_sets import BOTH, COMMON, FREE, SPLATS, STAND_INS, Shape, make_level_set

FOLDER = Path(__file__).parent / "vectors"
_FINE, _HALF = Quantizer(CodingId.AFFINE16), Quantizer(CodingId.HALF)
FINE = CodingPlan(_HALF, _FINE, _HALF, _FINE, _HALF, _FINE)
PAPER = Shape(
    anchors=(14, 30, 60), slots=5, grids=(4, 6, 8), features=4, entries=16, code_width=6, hidden=8,
    fuse=(10, 8),
)  # fmt: skip
VALUES = Shape(
    anchors=(10, 20, 34, 50), grids=(0, 0, 0, 0), features=0, entries=0, code_width=0, residual=12,
    hidden=8,
)  # fmt: skip
TIED = replace(VALUES, anchors=(8, 16, 24, 32), slots=16, keep=0.2, common=True)
VECTORS = {
    "small-compact": (Shape(anchors=(12, 30, 61, 90)), "compact"),
    "both-raw": (BOTH, "raw"),
    "free-compact": (FREE, "compact"),
    "small-fine": (Shape(), FINE),
    "empty-first": (Shape(anchors=(0, 5, 5, 12)), "compact"),
    "common-compact": (COMMON, "compact"),
    "paper-sequential": (PAPER, "compact"),
    "values-joint": (VALUES, "compact"),
    "values-tied": (TIED, "compact"),
    "splats-compact": (replace(SPLATS, anchors=(5, 12, 22, 34), common=True), "compact"),
    "splats-raw": (replace(SPLATS, anchors=(0, 7, 20), degree=1, code_width=3), "raw"),
    "values-paged": (replace(VALUES, anchors=(26, 44, 60, 80)), "compact"),
    "splats-dropped": (replace(STAND_INS, anchors=(5, 11, 24, 38)), "compact"),
}
RESOLUTIONS = (2, 3, 4, 5, 9, 18, 80, 514)
"""Of the paper's file: the first three are dense, the second has rows of padding."""
ROWS = (8, 32, 64, 64, 61, 64, 64, 64)
"""Of its grids."""


def _as_trained(
    levels: LevelSet, contract: bool, wide: float = 2.0, opaque: float = 0.4
) -> LevelSet:
    """Gaussians some pixels wide that mostly show, in a frame that most of them are beyond."""
    shared = replace(levels.shared, log_scales=levels.shared.log_scales + np.float32(wide))
    frame = Frame(0.1, np.array([0.11, -0.07, 0.23]), 0.45, contract, 3.3)
    vivid = tuple(replace(level, networks=_vivid(level, opaque)) for level in levels.levels)
    return LevelSet(frame, shared, vivid, levels.meta)


def _vivid(level: Level, opaque: float) -> dict[str, Float32]:
    """Networks whose outputs differ more from slot to slot, opacity mostly positive."""
    strong = {n: w * np.float32(3 if n.endswith("w2") else 1) for n, w in level.networks.items()}
    return strong | {"opacity_b2": strong["opacity_b2"] + np.float32(opaque)}


def _noted(levels: LevelSet, **notes: object) -> LevelSet:
    return replace(levels, meta={**levels.meta, **{n: json.dumps(v) for n, v in notes.items()}})


def _paper(levels: LevelSet) -> LevelSet:
    rng = np.random.default_rng(11)
    grids = tuple((rng.standard_normal((n, 4)) * 0.3).astype(np.float32) for n in ROWS)
    shared = replace(levels.shared, grids=grids, grid_resolutions=RESOLUTIONS)
    levels = _as_trained(replace(levels, shared=shared), contract=True)
    seen = {"center": [0, 0], "radius": 1, "distance": [0.9, 0.9]}
    return _noted(levels, seen=seen, focals=[[9, 9], [9, 9]])


def _joint(levels: LevelSet) -> LevelSet:
    seen = {"center": [0.1, 0.2, -3.1], "radius": 0.75, "distance": [1.05, 1.3]}
    focals = [[12, 16.5], [24, 30], [33, 60], [95.5, 120]]
    return _noted(_as_trained(levels, contract=False), seen=seen, focals=focals)


def _tied(levels: LevelSet) -> LevelSet:
    seen = {"center": [0, 0.5, 0], "radius": 4, "distance": [0.02, 2.5]}
    levels = _as_trained(levels, contract=False, wide=1.3, opaque=3.5)
    return _noted(levels, seen=seen, focals=[[40, 50]] * 4)


def _splats(levels: LevelSet) -> LevelSet:
    """Some of them far from opaque, as anti-aliased training leaves them."""
    return _noted(levels, focals=[[2.0**40, 2.0**40]] * len(levels.levels))


def _dropped(levels: LevelSet) -> LevelSet:
    """Splats of the first two levels are stand-ins for those of the last two."""
    return _noted(levels, focals=[[24, 40], [24, 40], [2.0**-40, 2.0**40], [2.0**-40, 2.0**40]])


DRESSED: dict[str, Callable[[LevelSet], LevelSet]] = {
    "paper-sequential": _paper,
    "values-joint": _joint,
    "values-tied": _tied,
    "splats-raw": _splats,
    "splats-dropped": _dropped,
}
"""What is changed of the random level set of a name; the others are as they come."""


def level_set(name: str) -> LevelSet:
    """What is written into the file of a name."""
    levels = make_level_set(np.random.default_rng(list(VECTORS).index(name)), VECTORS[name][0])
    return DRESSED[name](levels) if name in DRESSED else levels


def encoded(name: str) -> bytes:
    """The file of a name."""
    page, block = (2, 4) if name == "values-paged" else (PAGE_BLOCKS, 16)
    return encode_with_account(level_set(name), VECTORS[name][1], block=block, page=page)[0]


def digest(levels: LevelSet) -> str:
    """SHA-256 over all decoded arrays, little-endian, in the order of the records' fields."""
    s, total = levels.shared, hashlib.sha256()
    arrays: list[np.ndarray] = [s.lattice, s.log_scales, s.offsets, s.codes, s.residual, *s.grids]
    for level in levels.levels:
        arrays += [level.mask, level.codebook, *level.networks.values(), level.gain]
    for array in arrays:
        total.update(np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes())
    return total.hexdigest()


def main() -> None:
    from tests.container.drawings import write_drawings  # reading vectors needs no PyTorch

    digests: dict[str, list[str]] = {}
    for name in VECTORS:
        data = encoded(name)
        (FOLDER / f"{name}.gsyn").write_bytes(data)
        count = len(decode(data, name).levels)
        digests[name] = [digest(decode(data, name, k)) for k in range(count)]
    (FOLDER / "digests.json").write_text(json.dumps(digests, indent=1) + "\n")
    write_drawings(FOLDER, list(VECTORS))
    print(f"wrote {FOLDER}")


if __name__ == "__main__":
    main()
