"""Points with colours from a PLY file: ascii or binary, vertices first."""

import os
import re
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import SceneError
from gsynopsis.files import open_regular

TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
SHADES = ("red", "green", "blue")
GREY = 128
"""Colour of points that have none."""
BRIGHTEST = 2.0
"""Colours as floats that go no higher are shares, a little above 1 where light was added up."""
COUNT = re.compile(r"[0-9]{1,18}")
"""A number of vertices that could be one."""
HEADER = re.compile(rb"\Aply\r?\n(.*?)end_header\r?\n", re.DOTALL)
HEADER_MOST, LINE_MOST = 1 << 20, 1 << 16
"""Most bytes of a header, and of a line of numbers."""
LINES = 1 << 16
"""Lines that are split at a time: their words take far more memory than their numbers."""


def read_ply(path: Path) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """The vertices of a PLY file, float64 [P, 3], and their colours, uint8 [P, 3].

    Colours are uchar, or floats from 0 to 1 as Open3D and CloudCompare write them; vertices without
    red, green and blue are grey.

    Raises:
        SceneError: The file is unreadable, truncated, or not a PLY with x, y and z.
    """
    with open_regular(path, SceneError, "a readable file") as file:
        try:
            table = _read_vertices(path, file)
        except OSError as error:
            raise SceneError(path, found=error.strerror, expected="a readable file") from error
    points = np.stack([table[axis].astype(np.float64) for axis in "xyz"], axis=1)
    colors = np.full(points.shape, GREY, np.uint8)
    if set(SHADES) <= set(table.dtype.names or ()):
        shades = np.stack([table[shade] for shade in SHADES], axis=1)
        colors = shades.astype(np.uint8) if shades.dtype == np.uint8 else _bytes_of(path, shades)
    return points, colors


def ply_bytes(points: NDArray[np.float64], colors: NDArray[np.uint8]) -> bytes:
    """A binary PLY of points [P, 3] and their colours [P, 3]; `read_ply` gives the same."""
    fields = [*((axis, "<f8") for axis in "xyz"), *((shade, "u1") for shade in SHADES)]
    table = np.empty(len(points), np.dtype(fields))
    for place, axis in enumerate("xyz"):
        table[axis] = points[:, place]
    for place, shade in enumerate(SHADES):
        table[shade] = colors[:, place]
    properties = [*(f"property double {a}" for a in "xyz")]
    properties += [f"property uchar {shade}" for shade in SHADES]
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}", *properties]
    return ("\n".join([*head, "end_header"]) + "\n").encode() + table.tobytes()


def _read_vertices(path: Path, file: BinaryIO) -> NDArray[np.void]:
    """The vertices as they are stored, [P]; what stands behind them is not read."""
    head = file.read(HEADER_MOST)
    match = HEADER.match(head)
    if match is None:
        raise SceneError(path, "header", found=head[:20], expected="ply … end_header")
    order, count, fields = _parse_header(path, match[1].decode("ascii", "replace"))
    file.seek(match.end())
    rest = os.fstat(file.fileno()).st_size - match.end()
    layout = np.dtype([(name, order + kind) for name, kind in fields])
    if order == "=":
        return _read_ascii(path, file, count, rest, layout)
    if count * layout.itemsize > rest:
        wanted = f"{count} of {layout.itemsize} bytes"
        raise SceneError(path, "vertices", found=f"{rest} bytes", expected=wanted)
    return np.fromfile(file, layout, count)


def _bytes_of(path: Path, shades: NDArray[Any]) -> NDArray[np.uint8]:
    """Colours as bytes: of floats up to 1, of 16 bits, or of other numbers up to 255."""
    values = np.nan_to_num(shades.astype(np.float64), nan=GREY / 255)
    top = float(values.max(initial=0))
    if shades.dtype.kind == "f" and top <= BRIGHTEST:
        largest, values = 1.0, values.clip(0, 1)
    else:
        largest = 65535.0 if top > 255 and shades.dtype == np.uint16 else 255.0
    if values.min(initial=0) < 0 or top > max(largest, BRIGHTEST):
        found = f"{values.min():g} to {top:g}"
        raise SceneError(path, "colours", found=found, expected=f"0 to {largest:g}")
    return np.rint(values * (255 / largest)).astype(np.uint8)


def _parse_header(path: Path, text: str) -> tuple[str, int, list[tuple[str, str]]]:
    """Byte order, number of vertices, and (name, type) of each property of a vertex."""
    order, count = "", -1
    fields: list[tuple[str, str]] = []
    for words in (line.split() for line in text.splitlines()):
        match words:
            case ["format", name, _] if name in ORDERS:
                order = ORDERS[name]
            case ["element", "vertex", number] if count < 0 and COUNT.fullmatch(number):
                count = int(number)
            case ["element", *_] if count >= 0:
                break
            case ["property", kind, name] if count >= 0 and kind in TYPES:
                fields.append((name, TYPES[kind]))
            case ["comment" | "obj_info", *_] | []:
                pass
            case _:
                found = " ".join(words)[:60]
                raise SceneError(path, "header", found=found, expected="vertices of plain numbers")
    names = [name for name, _ in fields]
    if not order or len(set(names)) < len(names) or not {"x", "y", "z"} <= set(names):
        raise SceneError(path, "header", found=names, expected="a format, and x, y, z once each")
    return order, count, fields


def _read_ascii(
    path: Path, file: BinaryIO, count: int, rest: int, layout: np.dtype[np.void]
) -> NDArray[np.void]:
    """As many lines of numbers, a part of them at a time; `rest` bytes are left."""
    width = len(layout.names or ())
    # A number and what separates it take two bytes, but for the end of the last line.
    table = np.empty(min(count, rest // (2 * width) + 1), layout)
    for start in range(0, len(table), LINES):
        part, rows = table[start : start + LINES], list[list[bytes]]()
        while len(rows) < len(part) and len(row := file.readline(LINE_MOST).split()) == width:
            rows.append(row)
        if len(rows) < len(part) or start + len(rows) == len(table) < count:
            found, wanted = f"{start + len(rows)} lines", f"{count} lines of {width} numbers"
            raise SceneError(path, "vertices", found=found, expected=wanted)
        try:
            columns = [np.array([float(row[index]) for row in rows]) for index in range(width)]
        except ValueError as error:
            raise SceneError(path, "vertices", found=str(error), expected="numbers") from error
        with np.errstate(all="ignore"):
            for name, column in zip(layout.names or (), columns, strict=True):
                part[name] = column.astype(layout[name])
    return table
