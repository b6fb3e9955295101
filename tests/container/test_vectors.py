"""Two decoders that share nothing agree on committed files."""

import json

import numpy as np
import pytest

from benchmarks.robust.forge import index_of
from gsynopsis.container import decode
from gsynopsis.records import LevelSet
from tests.container.plain_reader import Refused, read_plain
from tests.container.vectors import FOLDER, VECTORS, digest, encoded

DIGESTS = json.loads((FOLDER / "digests.json").read_text())


def assert_agree(levels: LevelSet, plain: dict) -> None:
    s = levels.shared
    for name in ("lattice", "log_scales", "codes", "residual"):
        found = getattr(s, name)
        if found.ndim > 1 and name == "codes":
            plain["codes"] = [row + [0] * (found.shape[1] - len(row)) for row in plain["codes"]]
        other = np.array(plain[name], found.dtype).reshape(found.shape)
        assert other.tobytes() == found.tobytes(), name
    offsets = np.zeros_like(s.offsets)
    for (anchor, slot), row in plain["offsets"].items():
        offsets[anchor, slot] = row
    assert offsets.tobytes() == s.offsets.tobytes()
    assert list(s.grid_resolutions) == plain["resolutions"]
    for grid, other in zip(s.grids, plain["grids"], strict=True):
        assert np.array(other, np.float32).tobytes() == grid.tobytes()
    for level, other in zip(levels.levels, plain["levels"], strict=True):
        assert np.array(other["mask"], np.bool_).tobytes() == level.mask.tobytes()
        assert np.array(other["gain"], np.float32).tobytes() == level.gain.tobytes()
        codebook = np.array(other.get("codebook", []), np.float32)
        assert codebook.tobytes() == level.codebook.tobytes()
        assert list(other["networks"]) == list(level.networks)
        for name, weights in level.networks.items():
            assert np.array(other["networks"][name], np.float32).tobytes() == weights.tobytes()
    assert plain["meta"] == dict(levels.meta)


@pytest.mark.parametrize("name", VECTORS)
def test_both_readers_agree_on_every_prefix(name: str) -> None:
    data = (FOLDER / f"{name}.gsyn").read_bytes()
    assert len(data) < 16384
    for k, level in enumerate(index_of(data).levels):
        levels = decode(data[: level.end], name)
        assert digest(levels) == DIGESTS[name][k]
        assert_agree(levels, read_plain(data[: level.end]))


@pytest.mark.parametrize("name", VECTORS)
def test_the_script_still_makes_files_of_these_values(name: str) -> None:
    """Not their bytes, which depend on zlib."""
    data = encoded(name)
    for k, expected in enumerate(DIGESTS[name]):
        assert digest(decode(data, name, k)) == expected


def test_a_changed_byte_is_seen_by_both() -> None:
    data = (FOLDER / "small-compact.gsyn").read_bytes()
    for at in range(0, len(data), 37):
        changed = data[:at] + bytes([data[at] ^ 16]) + data[at + 1 :]
        with pytest.raises((Refused, ValueError, KeyError)):
            read_plain(changed)


def test_the_plain_reader_is_short() -> None:
    text = (FOLDER.parent / "plain_reader.py").read_text()
    assert len(text.splitlines()) < 310
    assert "gsynopsis" not in text.split('"""')[2]
