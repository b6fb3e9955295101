"""Points from PLY files, whole and broken."""

import os
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from gsynopsis.errors import SceneError
from gsynopsis.scene.ply import read_ply

FIELDS = "property float x\nproperty float y\nproperty float z\n"
SHADES = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
ROWS = [(0.5, 1.0, -2.0, 255, 0, 9), (3.0, 4.0, 5.5, 1, 2, 3)]


def header(form: str, count: int = 2, fields: str = FIELDS + SHADES, more: str = "") -> bytes:
    text = (
        f"ply\nformat {form} 1.0\ncomment one\nelement vertex {count}\n{fields}{more}end_header\n"
    )
    return text.encode()


def binary(order: str = "<") -> bytes:
    return b"".join(struct.pack(order + "3f3B", *row) for row in ROWS)


ASCII = b"\n".join(b" ".join(b"%g" % value for value in row) for row in ROWS) + b"\n"


@pytest.mark.parametrize(
    "content",
    [
        header("ascii") + ASCII,
        header("binary_little_endian") + binary(),
        header("binary_big_endian") + binary(">"),
        header("ascii").replace(b"\n", b"\r\n") + ASCII,
        header("ascii", more="element face 1\nproperty list uchar int vertex_indices\n")
        + ASCII
        + b"3 0 1 0\n",
    ],
)
def test_vertices_are_the_same_in_every_format(tmp_path, content):
    path = tmp_path / "points.ply"
    path.write_bytes(content)
    points, colors = read_ply(path)
    np.testing.assert_array_equal(points, [row[:3] for row in ROWS])
    np.testing.assert_array_equal(colors, [row[3:] for row in ROWS])
    assert points.dtype == np.float64 and colors.dtype == np.uint8


def test_points_without_colours_are_grey(tmp_path):
    path = tmp_path / "points.ply"
    path.write_bytes(header("ascii", fields=FIELDS) + b"1 2 3\n4 5 6\n")
    points, colors = read_ply(path)
    assert points.tolist() == [[1, 2, 3], [4, 5, 6]] and (colors == 128).all()


@pytest.mark.parametrize(
    ("kind", "rows"),
    [
        ("float", "1 2 3 0 0.5 1\n4 5 6 1.0 0.25 1.01\n"),
        ("double", "1 2 3 0 0.5 1\n4 5 6 1.0 0.25 1.01\n"),
        ("float", "1 2 3 0 128 255\n4 5 6 255 64 255\n"),
        ("int", "1 2 3 0 128 255\n4 5 6 255 64 255\n"),
        ("ushort", "1 2 3 0 32896 65535\n4 5 6 65535 16448 65535\n"),
    ],
)
def test_colours_of_every_type_are_bytes(tmp_path: Path, kind: str, rows: str) -> None:
    path = tmp_path / "points.ply"
    shades = SHADES.replace("uchar", kind)
    path.write_bytes(header("ascii", fields=FIELDS + shades) + rows.encode())
    assert read_ply(path)[1].tolist() == [[0, 128, 255], [255, 64, 255]]


def test_colours_that_cannot_be_are_refused(tmp_path: Path) -> None:
    path, shades = tmp_path / "points.ply", SHADES.replace("uchar", "int")
    path.write_bytes(header("ascii", fields=FIELDS + shades) + b"1 2 3 0 0 0\n4 5 6 0 300 0\n")
    with pytest.raises(
        SceneError, match=r"points\.ply: colours: found 0 to 300, expected 0 to 255"
    ):
        read_ply(path)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_every_truncation_is_refused(tmp_path: Path, form: str):
    path = tmp_path / "points.ply"
    body = ASCII.rstrip() if form == "ascii" else binary()
    whole = header(form) + body
    # The last digits of text can be cut without a trace.
    for size in range(len(whole) - 1 if form == "ascii" else len(whole)):
        path.write_bytes(whole[:size])
        with pytest.raises(SceneError, match=r"points\.ply: "):
            read_ply(path)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"solid", "header: found b'solid', expected ply"),
        (header("ascii", 10**15) + ASCII, "vertices: found 2 lines, expected 10{15} lines"),
        (header("binary_little_endian", 10**15) + binary(), "vertices: found 30 bytes, expected"),
        (header("binary_middle_endian"), "header: found format binary_middle_endian"),
        (header("ascii", fields="property float x\n"), r"header: found \['x'\], expected a format"),
        (header("ascii", fields=FIELDS + FIELDS), "expected a format, and x, y, z once each"),
        (header("ascii", fields="property list uchar int x\n"), "header: found property list"),
        (header("ascii") + b"1 2 3 4 5 red\n1 2 3 4 5 6\n", "vertices: found could not convert"),
    ],
)
def test_a_broken_file_is_refused(tmp_path, content, words):
    path = tmp_path / "points.ply"
    path.write_bytes(content)
    with pytest.raises(SceneError, match=words):
        read_ply(path)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(SceneError, match="found No such file or directory, expected a readable"):
        read_ply(tmp_path / "gone.ply")


@pytest.mark.parametrize("start", [b"", header("ascii"), header("binary_little_endian")])
def test_of_a_sparse_file_little_is_read(tmp_path: Path, start: bytes) -> None:
    path = tmp_path / "points.ply"
    path.write_bytes(start)
    os.truncate(path, 3 << 30)
    tracemalloc.start()
    if start.startswith(header("binary_little_endian")):
        assert read_ply(path)[0].tolist() == [[0, 0, 0]] * 2
    else:
        with pytest.raises(SceneError, match=r"(header|vertices): found"):
            read_ply(path)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 1 << 24


def test_lines_are_read_in_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gsynopsis.scene.ply.LINES", 3)
    path = tmp_path / "points.ply"
    lines = [f"{n} 0 1\n" for n in range(8)]
    path.write_text(header("ascii", 8, FIELDS).decode() + "".join(lines))
    assert read_ply(path)[0].tolist() == [[n, 0, 1] for n in range(8)]
    for bad in (2, 3, 7):
        changed = [*lines[:bad], "1 2\n", *lines[bad + 1 :]]
        path.write_text(header("ascii", 8, FIELDS).decode() + "".join(changed))
        with pytest.raises(SceneError, match=f"found {bad} lines, expected 8 lines of 3"):
            read_ply(path)
