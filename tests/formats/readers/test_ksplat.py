"""`.ksplat`: against gaussforge, which writes it, and in sections of several buckets."""

import struct
from pathlib import Path

import numpy as np
import pytest

from gsynopsis.errors import InputError
from gsynopsis.formats.readers.any import read_splats
from gsynopsis.formats.writers.ply import ply_bytes
from gsynopsis.records import PlainGaussians
from tests.formats.scattered import scattered


def sorted_rows(g: PlainGaussians) -> np.ndarray:
    """Values that do not depend on the order of splats, by position."""
    opacity = 1 / (1 + np.exp(-g.logits))
    turn = g.quaternions / np.linalg.norm(g.quaternions, axis=1, keepdims=True)
    turn = turn * np.sign(turn[:, :1])
    rows = np.concatenate(
        [g.means, np.exp(g.log_scales), turn, opacity[:, None], g.sh.reshape(len(g), -1)], axis=1
    )
    return rows[np.lexsort(np.round(rows[:, :3], 2).T)]


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_what_gaussforge_writes_is_read(degree: int, tmp_path: Path) -> None:
    gaussforge = pytest.importorskip("gaussforge")
    g = scattered(50, degree)
    made = gaussforge.GaussForge().convert(ply_bytes(g), "ply", "ksplat")
    (tmp_path / "a.ksplat").write_bytes(made["data"])
    found = read_splats(tmp_path / "a.ksplat")
    assert found.kind == "ksplat" and found.up == (0, -1, 0)
    own, theirs = sorted_rows(found.levels[0]), sorted_rows(g)
    # Of degree 2 gaussforge has red's eight coefficients together, where the viewer of the format
    # has each degree's: only the first is compared.
    width = 23 if degree < 2 else 14
    assert own.shape == theirs.shape
    assert np.allclose(own[:, :width], theirs[:, :width], atol=2e-2)


def ksplat(level: int, counts: list[int], degree: int = 0) -> bytes:
    """Splats at whole places in two sections, the second with a full bucket and two others."""
    rng = np.random.default_rng(0)
    room = [8, sum(counts)]
    head = struct.pack("<BBxxIIIIHxxfffff", 0, 1, 2, 2, 16, 2 + sum(counts), level, 0, 0, 0, -2, 2)
    parts, tables = [], []
    for number, sizes in enumerate(([2], counts)):
        full, others = (0, sizes) if not number else (1, sizes[1:])
        centers = np.arange(3 * len(sizes), dtype="<f4").reshape(-1, 3) * 10
        tables.append(
            struct.pack(
                "<IIIIfHxxIIIIH",
                *(sum(sizes), room[number], sizes[0], len(sizes) if level else 0, 4.0),
                *(12, 100, 0, full if level else 0, len(others) if level else 0, degree),
            ).ljust(1024, b"\0")
        )
        rows = b""
        for bucket, size in enumerate(sizes):
            for _ in range(size):
                place = centers[bucket] + np.float32([1, 0, -1])
                color, sh = bytes([255, 0, 128, 255]), 9 if degree else 0
                if level:
                    rows += np.array([150, 100, 50], "<u2").tobytes()
                    rows += np.array([0.5] * 3 + [1, 0, 0, 0], "<f2").tobytes() + color
                    rest = np.arange(sh)
                    rows += (rest.astype("<f2") if level == 1 else rest.astype("u1")).tobytes()
                else:
                    rows += np.array([*place, *[0.5] * 3, 1, 0, 0, 0], "<f4").tobytes() + color
                    rows += np.arange(sh).astype("<f4").tobytes()
        width = len(rows) // sum(sizes)
        rows += rng.bytes(width * (room[number] - sum(sizes)))
        meta = np.array(others, "<u4").tobytes() + centers.tobytes() if level else b""
        parts.append(meta + rows)
    return head.ljust(4096, b"\0") + b"".join(tables) + b"".join(parts)


@pytest.mark.parametrize("degree", [0, 1])
@pytest.mark.parametrize("level", [0, 1, 2])
def test_positions_stand_around_their_buckets(level: int, degree: int, tmp_path: Path) -> None:
    path = tmp_path / "a.ksplat"
    path.write_bytes(ksplat(level, [4, 3, 2], degree))
    g = read_splats(path).levels[0]
    base = [0] * 2 + [0] * 4 + [30] * 3 + [60] * 2
    assert np.allclose(g.means[:, 0], np.array(base) + 1, atol=1e-4)
    assert np.allclose(g.means[:, 2], np.array(base) + 20 - 1, atol=1e-4)
    assert np.allclose(g.log_scales, np.log(0.5)) and (g.sh[:, 0, 0] > 1.7).all()
    if degree:  # red's three coefficients stand together
        values = np.arange(9.0) if level < 2 else -2 + 4 * np.arange(9) / 255
        assert np.allclose(g.sh[0, 1:].T.reshape(-1), values, atol=1e-3)


@pytest.mark.parametrize("at", [0, 4, 16, 20, 4096 + 40, 4096 + 1024 + 12, 4096 + 2048 + 1])
def test_a_spoilt_header_is_one_line(at: int, tmp_path: Path) -> None:
    data = bytearray(ksplat(1, [4, 3, 2]))
    data[at] ^= 0x77
    path = tmp_path / "a.ksplat"
    path.write_bytes(data)
    with pytest.raises(InputError) as caught:
        read_splats(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_a_short_file_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "a.ksplat"
    for length in (0, 40, 4096, 6300):
        path.write_bytes(ksplat(1, [4, 3, 2])[:length])
        with pytest.raises(InputError):
            read_splats(path)
