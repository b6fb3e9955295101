"""Files of Gaussians are read by what they begin with, and hostile ones refused in one line."""

import gzip
import io
import json
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsynopsis.errors import InputError
from gsynopsis.formats.readers.any import read_splats

NAMES = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2"]
REST = [f"f_rest_{i}" for i in range(9)]
LAST = ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]


def header(order: str, count: int, names: list[str], comment: str = "") -> bytes:
    lines = ["ply", f"format {order} 1.0", *([f"comment {comment}"] if comment else [])]
    lines += [f"element vertex {count}", *(f"property float {name}" for name in names)]
    return ("\n".join([*lines, "end_header"]) + "\n").encode()


def ply(folder: Path, values: np.ndarray, order: str, comment: str = "") -> Path:
    names = NAMES + REST + LAST
    kind = {"binary_little_endian": "<f4", "binary_big_endian": ">f4"}.get(order)
    if kind:
        body = values.astype(kind).tobytes()
    else:
        body = "\n".join(" ".join(map(repr, row)) for row in values.tolist()).encode()
    path = folder / "a.ply"
    path.write_bytes(header(order, len(values), names, comment) + body)
    return path


@pytest.fixture
def values(rng: np.random.Generator) -> np.ndarray:
    return rng.standard_normal((5, 23)).astype(np.float32)


@pytest.mark.parametrize("order", ["binary_little_endian", "binary_big_endian", "ascii"])
def test_a_ply_is_read_in_every_byte_order(order: str, values: np.ndarray, tmp_path: Path) -> None:
    found = read_splats(ply(tmp_path, values, order, "SplatRenderMode: mip"))
    gaussians = found.levels[0]
    assert found.antialiased
    assert np.array_equal(gaussians.means, values[:, :3])
    assert np.array_equal(gaussians.sh[:, 0], values[:, 3:6])
    # The file's harmonics stand colour by colour.
    assert np.array_equal(gaussians.sh[:, 1:], values[:, 6:15].reshape(5, 3, 3).swapaxes(1, 2))
    assert np.array_equal(gaussians.quaternions, values[:, 19:])


def spz(count: int, version: int = 3, points: int | None = None) -> bytes:
    head = struct.pack("<4sIIBBBB", b"NGSP", version, count, 0, 12, 1, 0)
    turn = 4 if version > 2 else 3
    n = count if points is None else points
    body = bytes([0, 16, 0] * 3 * n) + b"\x80" * n + b"\x80" * 3 * n + b"\x50" * 3 * n
    return gzip.compress(head + body + (b"\xff\xff\xff\xff" if turn == 4 else b"\x80" * 3) * n)


@pytest.mark.parametrize("version", [2, 3])
def test_an_spz_is_read(version: int, tmp_path: Path) -> None:
    path = tmp_path / "a.spz"
    path.write_bytes(spz(3, version))
    found = read_splats(path)
    assert found.antialiased
    assert found.levels[0].means.tolist() == [[1, 1, 1]] * 3
    assert (found.levels[0].log_scales == -5).all()


def picture(width: int, height: int) -> bytes:
    stream = io.BytesIO()
    Image.new("RGBA", (width, height), (128, 128, 128, 252)).save(stream, "WEBP", lossless=True)
    return stream.getvalue()


def sog(path: Path, count: int, size: tuple[int, int]) -> Path:
    codebook = np.linspace(-1, 1, 256).tolist()
    meta = {
        "version": 2,
        "count": count,
        "means": {"mins": [-1] * 3, "maxs": [1] * 3, "files": ["l.webp", "u.webp"]},
        "quats": {"files": ["q.webp"]},
        "scales": {"codebook": codebook, "files": ["s.webp"]},
        "sh0": {"codebook": codebook, "files": ["c.webp"]},
    }
    with zipfile.ZipFile(path, "w") as bundle:
        bundle.writestr("meta.json", json.dumps(meta))
        for name in "luqsc":
            bundle.writestr(f"{name}.webp", picture(*size))
    return path


def test_a_bundled_sog_is_read(tmp_path: Path) -> None:
    gaussians = read_splats(sog(tmp_path / "a.sog", 5, (4, 2))).levels[0]
    assert len(gaussians) == 5
    assert np.allclose(np.abs(gaussians.means), np.expm1(32896 / 65535 * 2 - 1), atol=1e-6)
    assert np.allclose(np.linalg.norm(gaussians.quaternions, axis=1), 1)


def test_a_family_of_ply_files_comes_in_as_levels(values: np.ndarray, tmp_path: Path) -> None:
    for level, rows in enumerate((5, 2)):
        path = ply(tmp_path, values[:rows], "binary_little_endian")
        path.rename(tmp_path / f"a_lod{level}.ply")
    assert [len(v) for v in read_splats(tmp_path / "a_lod0.ply").levels] == [2, 5]


HOSTILE = {
    "nothing": b"",
    "no splats": header("binary_little_endian", 0, NAMES + LAST),
    "50 million splats": header("binary_little_endian", 50_000_000, NAMES + LAST),
    "more rows than bytes": header("binary_little_endian", 9, NAMES + LAST) + bytes(100),
    "a count of 30 digits": header("binary_little_endian", 10**30, NAMES + LAST),
    "no scales": header("binary_little_endian", 1, NAMES) + bytes(24),
    "seven harmonics": header("binary_little_endian", 1, NAMES + REST[:7] + LAST) + bytes(84),
    "a name twice": header("binary_little_endian", 1, [*NAMES, "x", *LAST]) + bytes(60),
    "zero rotation": header("binary_little_endian", 1, NAMES + LAST) + bytes(56),
    "not finite": header("binary_little_endian", 1, NAMES + LAST) + b"\xff" * 56,
    "no end of the header": b"ply\nformat ascii 1.0\n" + b"comment x\n" * 9000,
    "words for numbers": header("ascii", 1, NAMES + LAST) + b"a " * 14,
    "SPZ of a huge count": spz(2**32 - 1, points=1),
    "SPZ of many": spz(19_000_000, points=1),
    "SPZ cut": spz(100)[:40],
    "SPZ of version 9": spz(3, 9),
    "SPZ 4 cut": b"NGSP" + struct.pack("<IIBBBB", 4, 3, 0, 12, 0, 5),
    "no zip": b"PK\x03\x04" + bytes(50),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.ply"
    path.write_bytes(HOSTILE[name])
    with pytest.raises(InputError) as caught:
        read_splats(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("size", [(1, 1), (4, 1), (400, 400)])
def test_a_sog_with_pictures_of_the_wrong_size_is_refused(
    size: tuple[int, int], tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=f"{size[0]} x {size[1]}"):
        read_splats(sog(tmp_path / "a.sog", 5, size))


def test_a_folder_without_splats_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a folder without"):
        read_splats(tmp_path)
