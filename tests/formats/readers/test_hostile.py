"""Small files that say they are large, pipes for files, streams that break: one line each."""

import gzip
import io
import json
import os
import struct
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsynopsis.errors import InputError
from gsynopsis.formats.readers.any import read_splats
from tests.formats.readers.test_any import picture, sog

MIB = 1 << 20


def refused(path: Path, most: int = 256 * MIB) -> str:
    """The line with which a file is refused; reading it took no more memory than that."""
    tracemalloc.start()
    try:
        with pytest.raises(InputError) as caught:
            read_splats(path)
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 600
    return str(caught.value)


def spz4(streams: list[bytes], count: int, sizes: list[int]) -> bytes:
    head = struct.pack("<4sIIBBBBI", b"NGSP", 4, count, 0, 12, 0, len(streams), 32)
    table = b"".join(struct.pack("<QQ", len(s), n) for s, n in zip(streams, sizes, strict=True))
    return head.ljust(32, b"\0") + table + b"".join(streams)


@pytest.mark.parametrize("told", [True, False])
def test_a_zstd_frame_is_not_believed_about_its_size(told: bool, tmp_path: Path) -> None:
    zstandard = pytest.importorskip("zstandard")
    packer = zstandard.ZstdCompressor(write_content_size=told)
    sizes = [27, 3, 9, 9, 12]
    streams = [packer.compress(bytes(600 * MIB)), *(packer.compress(bytes(n)) for n in sizes[1:])]
    path = tmp_path / "a.spz"
    path.write_bytes(spz4(streams, 3, sizes))
    assert "stream 0" in refused(path)


def test_equal_splats_in_a_tiny_gzip_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.spz"
    head = struct.pack("<4sIIBBBB", b"NGSP", 2, 5_000_000, 3, 12, 0, 0)
    path.write_bytes(gzip.compress(head + bytes(64 * MIB), 9))
    assert "5,000,000" in refused(path)


def rewritten(path: Path, change: Callable[[dict[str, Any]], None], **kind: int) -> Path:
    """A SOG with another meta.json."""
    with zipfile.ZipFile(path) as bundle:
        files = {name: bundle.read(name) for name in bundle.namelist()}
    meta = json.loads(files["meta.json"])
    change(meta)
    files["meta.json"] = json.dumps(meta).encode()
    with zipfile.ZipFile(path, "w", **kind) as bundle:  # type: ignore[arg-type]
        for name, data in files.items():
            bundle.writestr(name, data)
    return path


def test_a_deflated_picture_is_no_larger_than_its_zip(tmp_path: Path) -> None:
    path = sog(tmp_path / "a.sog", 5, (4, 2))
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as bundle:
        bundle.writestr("big.webp", bytes(200 * MIB))

    def change(meta: dict[str, Any]) -> None:
        meta["means"]["files"][0] = "big.webp"

    assert "big.webp" in refused(
        rewritten(path, change, compression=zipfile.ZIP_DEFLATED), 300 * MIB
    )


def test_many_splats_in_few_bytes_of_pictures_are_refused(tmp_path: Path) -> None:
    assert "1,000,000" in refused(sog(tmp_path / "a.sog", 1_000_000, (1000, 1000)))


@pytest.mark.parametrize("kind", [zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_a_broken_stream_is_one_line(kind: int, tmp_path: Path) -> None:
    path = rewritten(sog(tmp_path / "a.sog", 5, (4, 2)), lambda meta: None, compression=kind)
    data = bytearray(path.read_bytes())
    start = data.find(b"meta.json") + 9
    data[start + 4 : start + 60] = b"\xff" * 56
    path.write_bytes(data)
    refused(path)


VALUES: dict[str, Callable[[dict[str, Any]], None]] = {
    "10^400": lambda meta: meta["means"].update(mins=[10**400, 0, 0]),
    "infinite": lambda meta: meta["means"].update(maxs=[1e999, 1e999, 1e999]),
    "a count of 10^400": lambda meta: meta.update(count=10**400),
    "a true count": lambda meta: meta.update(count=True),
    "deep": lambda meta: meta.update(version=eval("[" * 150 + "]" * 150)),
    "names of numbers": lambda meta: meta["quats"].update(files=[5]),
    "a name with NUL": lambda meta: meta["quats"].update(files=["a\0b"]),
    "a codebook of words": lambda meta: meta["scales"].update(codebook=["a"] * 256),
    "many pictures": lambda meta: meta["quats"].update(files=["q.webp"] * 1000),
    "version 9": lambda meta: meta.update(version=9),
    "no version": lambda meta: meta.pop("version"),
}


@pytest.mark.parametrize("name", VALUES)
def test_values_that_a_sog_cannot_have_are_one_line(name: str, tmp_path: Path) -> None:
    refused(rewritten(sog(tmp_path / "a.sog", 5, (4, 2)), VALUES[name]))


@pytest.mark.parametrize("text", [b"[" * 100_000, b'{"a":' * 100_000, b"[" + b"[]," * (20 * MIB)])
@pytest.mark.parametrize("name", ["meta.json", "lod-meta.json"])
def test_json_that_is_deep_or_long_is_one_line(name: str, text: bytes, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(text)
    refused(tmp_path / name)


def streamed(folder: Path, names: list[str], **more: object) -> Path:
    """A streamed SOG of one level, a piece of 5 splats from each name."""
    with zipfile.ZipFile(sog(folder / "a.sog", 5, (4, 2))) as bundle:
        bundle.extractall(folder / "0_0")
    pieces = [{"lods": {"0": {"file": k, "offset": 0, "count": 5}}} for k in range(len(names))]
    meta = {"lodLevels": 1, "filenames": names, "tree": {"children": pieces}, **more}
    path = folder / "lod-meta.json"
    path.write_text(json.dumps(meta))
    return path


def test_a_streamed_sog_has_each_splat_once(tmp_path: Path) -> None:
    name = "0_0/meta.json"
    assert len(read_splats(streamed(tmp_path, [name])).levels[0]) == 5
    assert "each once" in refused(streamed(tmp_path, [name] * 40))


@pytest.mark.parametrize("key", ["-1", "1", "٠", "x", "00000000000000"])
def test_a_level_that_is_none_is_one_line(key: str, tmp_path: Path) -> None:
    tree = {"lods": {key: {"file": 0, "offset": 0, "count": 5}}}
    refused(streamed(tmp_path, ["0_0/meta.json"], tree=tree))


def test_the_environment_is_part_of_every_level(tmp_path: Path) -> None:
    name = "0_0/meta.json"
    pieces = {str(k): {"file": 0, "offset": 0, "count": 5 - 2 * k} for k in range(2)}
    path = streamed(tmp_path, [name], lodLevels=2, tree={"lods": pieces}, environment=name)
    found = read_splats(path)
    assert [len(level) for level in found.levels] == [8, 10] and found.environment == 5
    assert "environment" in found.notes[0]
    refused(streamed(tmp_path, [name], environment="env/meta.json"))


@pytest.mark.parametrize("name", ["l.webp", "meta.json"])
@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "away"])
def test_what_is_no_regular_file_is_not_opened(name: str, kind: str, tmp_path: Path) -> None:
    with zipfile.ZipFile(sog(tmp_path / "a.sog", 5, (4, 2))) as bundle:
        bundle.extractall(tmp_path / "inner")
    inner = tmp_path / "inner" / name
    inner.unlink()
    if kind == "pipe":
        os.mkfifo(inner)
    elif kind == "folder":
        inner.mkdir()
    elif kind == "device":
        inner.symlink_to("/dev/zero")
    else:
        (tmp_path / "secret").write_bytes(picture(4, 2))
        inner.symlink_to(tmp_path / "secret")
    refused(tmp_path / "inner" / "meta.json")


def test_a_pipe_is_no_input(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.ply")
    assert "a pipe" in refused(tmp_path / "a.ply")


HEADER = "ply\nformat {} 1.0\nelement vertex {}\n{}end_header\n"
NAMES = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
NAMES += [*(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4))]
LINES = "".join(f"property float {name}\n" for name in NAMES)


@pytest.mark.parametrize(
    "start",
    [
        HEADER.format("binary_little_endian", 10_000_000, LINES).encode(),
        HEADER.format("ascii", 10_000_000, LINES).encode(),
        b"NGSP" + struct.pack("<IIBBBB", 4, 3, 0, 12, 0, 5),
        b"\x1f\x8b\x08\0\0\0\0\0\0\0",
        b"PK\x03\x04",
    ],
)
def test_three_gigabytes_of_nothing_are_refused_early(start: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(start)
    os.truncate(path, 3 << 30)
    refused(path)


def test_the_head_of_a_long_file_is_enough(rng: np.random.Generator, tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    rows = rng.standard_normal((3, len(NAMES))).astype("<f4")
    path.write_bytes(HEADER.format("binary_little_endian", 3, LINES).encode() + rows.tobytes())
    os.truncate(path, 3 << 30)
    assert np.array_equal(read_splats(path).levels[0].means, rows[:, :3])


def test_numbers_of_a_text_may_end_with_the_file(rng: np.random.Generator, tmp_path: Path) -> None:
    rows = rng.standard_normal((70_000, len(NAMES))).astype(np.float32)
    stream = io.StringIO()
    np.savetxt(stream, rows, "%.7g")
    path = tmp_path / "a.ply"
    path.write_text(HEADER.format("ascii", len(rows), LINES) + stream.getvalue().rstrip())
    assert np.allclose(read_splats(path).levels[0].means, rows[:, :3])
