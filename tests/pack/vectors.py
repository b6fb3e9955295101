"""The committed test vectors: small files of every shape and coding, for any decoder.

`python -m tests.pack.vectors` writes them again; the bytes depend on zlib, so it is for a change
of the format only. `digests.json` holds SHA-256 sums of the decoded values, see `digest`.
"""

import hashlib
import json
from pathlib import Path

import numpy as np

from gsynopsis.pack import decode
from gsynopsis.pack.layout import CodingId
from gsynopsis.pack.plan import Coder, CodingPlan
from gsynopsis.pack.writer import encode_with_account
from gsynopsis.records import LevelSet
from tests.level_sets import BOTH, COMMON, FREE, Shape, make_level_set

FOLDER = Path(__file__).parent / "vectors"
_FINE, _HALF = Coder(CodingId.AFFINE16), Coder(CodingId.HALF)
FINE = CodingPlan(_HALF, _FINE, _HALF, _FINE, _HALF, _FINE)
VECTORS = {
    "small-compact": (Shape(anchors=(12, 30, 61, 90)), "compact"),
    "both-raw": (BOTH, "raw"),
    "free-compact": (FREE, "compact"),
    "small-fine": (Shape(), FINE),
    "empty-first": (Shape(anchors=(0, 5, 5, 12)), "compact"),
    "common-compact": (COMMON, "compact"),
}


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
    digests: dict[str, list[str]] = {}
    for seed, (name, (shape, coding)) in enumerate(VECTORS.items()):
        levels = make_level_set(np.random.default_rng(seed), shape)
        data = encode_with_account(levels, coding, block=16)[0]
        (FOLDER / f"{name}.gsyn").write_bytes(data)
        count = len(levels.levels)
        digests[name] = [digest(decode(data, name, k)) for k in range(count)]
    (FOLDER / "digests.json").write_text(json.dumps(digests, indent=1) + "\n")
    print(f"wrote {FOLDER}")


if __name__ == "__main__":
    main()
