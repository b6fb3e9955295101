"""SPZ of version 1 (half floats), of degree 4, and with a record that names other axes."""

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest

from gsynopsis.errors import InputError
from gsynopsis.formats.axes import harmonic_values
from gsynopsis.formats.readers.any import read_splats
from gsynopsis.formats.readers.spz import SYSTEM, SYSTEMS
from tests.formats.trees import HEIGHT, crown_of, spz_bytes, tree

WAYS = {"R": (1, 0, 0), "L": (-1, 0, 0), "U": (0, 1, 0), "D": (0, -1, 0), "B": (0, 0, 1)}
WAYS["F"] = (0, 0, -1)


def records(system: int) -> bytes:
    """A record that nobody knows, then that of the axes."""
    return struct.pack("<II3x", 0xADBE0001, 3) + struct.pack("<III", SYSTEM, 4, system)


def extended(data: bytes, system: int) -> bytes:
    """The same file, which says its axes."""
    body = bytearray(gzip.decompress(data))
    body[14] |= 2
    return gzip.compress(bytes(body) + records(system))


def test_half_floats_are_positions_of_version_1(tmp_path: Path) -> None:
    g = tree((0, 1, 0))
    body = bytearray(gzip.decompress(spz_bytes(g)))
    body[4] = 1
    head, rest = bytes(body[:16]), bytes(body[16 + 9 * len(g) :])
    path = tmp_path / "a.spz"
    path.write_bytes(gzip.compress(head + g.means.astype("<f2").tobytes() + rest))
    found = read_splats(path)
    assert found.kind == "SPZ 1" and np.allclose(found.levels[0].means, g.means, atol=2e-3)
    assert crown_of(found.levels[0].means, found.levels[0].sh)[1] == pytest.approx(HEIGHT, abs=0.01)


@pytest.mark.parametrize("number", range(len(SYSTEMS)))
def test_axes_that_a_record_names_are_turned_to_ours(number: int, tmp_path: Path) -> None:
    own = tree((0, 1, 0))
    axes = np.array([WAYS[letter] for letter in SYSTEMS[number]], np.float64)
    moved = own.means.astype(np.float64) @ axes.T
    theirs = type(own)(
        moved.astype(np.float32), own.log_scales, own.quaternions, own.logits, own.sh
    )
    path = tmp_path / "a.spz"
    path.write_bytes(extended(spz_bytes(theirs), number))
    found = read_splats(path)
    assert found.up == (0, 1, 0)
    assert np.allclose(found.levels[0].means, own.means, atol=1e-3)
    assert bool(found.notes) == (SYSTEMS[number] != "RUB")


def test_a_mirrored_world_keeps_turns_and_colours_of_views(tmp_path: Path) -> None:
    from gsynopsis.formats.axes import matrix_of, mirrored
    from tests.formats.scattered import scattered

    g = scattered(5, 3)
    found = mirrored(g)
    signs = np.array([1.0, 1.0, -1.0])
    view = np.array([[0.36, 0.48, 0.8]])
    before = np.einsum("va,gac->gvc", harmonic_values(view, 16), g.sh)
    after = np.einsum("va,gac->gvc", harmonic_values(view * signs, 16), found.sh)
    assert np.allclose(before, after, atol=1e-5)
    q = g.quaternions / np.linalg.norm(g.quaternions, axis=1, keepdims=True)
    p = found.quaternions / np.linalg.norm(found.quaternions, axis=1, keepdims=True)
    for one, other in zip(q, p, strict=True):
        spread = matrix_of(one) @ np.diag([1.0, 4, 9]) @ matrix_of(one).T
        turned = matrix_of(other) @ np.diag([1.0, 4, 9]) @ matrix_of(other).T
        assert np.allclose(signs[:, None] * spread * signs, turned, atol=1e-5)


def test_axes_that_there_are_not_are_one_line(tmp_path: Path) -> None:
    path = tmp_path / "a.spz"
    path.write_bytes(extended(spz_bytes(tree((0, 1, 0))), 17))
    with pytest.raises(InputError, match="coordinate system: found 17"):
        read_splats(path)


def test_harmonics_of_degree_4_are_left_out_and_told(tmp_path: Path) -> None:
    g = tree((0, 1, 0))
    body = bytearray(gzip.decompress(spz_bytes(g)))
    body[12] = 4
    rest = np.tile(np.arange(72, dtype=np.uint8) + 100, len(g)).tobytes()
    path = tmp_path / "a.spz"
    path.write_bytes(gzip.compress(bytes(body) + rest))
    found = read_splats(path)
    assert found.levels[0].sh.shape == (len(g), 16, 3)
    assert found.levels[0].sh[0, 1, 0] == pytest.approx((100 - 128) / 128)
    assert found.notes == ("harmonics of degree 4 are left out",)
