"""PLY files of Gaussians: those of 3DGS and all that write like it; packed ones of SuperSplat.

Dialects differ in which properties there are, in their types and in the comments: SuperSplat leaves
out normals, Brush and Postshot the harmonics that are not trained, and all add their own.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import InputError
from gsynopsis.formats.readers.base import (
    SplatFile,
    check_count,
    check_room,
    checked,
)
from gsynopsis.records import HARMONICS, SH_0, Float32, PlainGaussians

HEADER_MAX = 1 << 16
"""Bytes of a header."""
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
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
RENDER_MODE = "splatrendermode"
"""Comment of Brush and Postshot; `mip` is the anti-aliased renderer."""
Array = NDArray[Any]


@dataclass(frozen=True)
class Element:
    """A kind of rows: its name, how many there are, and name and type of each property."""

    name: str
    count: int
    properties: list[tuple[str, str]]


class Ply(NamedTuple):
    """A header: byte order, elements in file order, comments, and where the rows begin."""

    order: str
    elements: dict[str, Element]
    comments: list[str]
    start: int


def read_ply(path: Path) -> SplatFile:
    """The Gaussians of a PLY file.

    Raises:
        InputError: it is none that holds Gaussians.
    """
    from gsynopsis.formats.readers.packed import unpack

    header = read_header(path)
    vertex = header.elements.get("vertex")
    if vertex is None:
        raise InputError(path, "header", found="no element vertex", expected="one")
    check_count(vertex.count, path)
    packed = "packed_position" in dict(vertex.properties)
    rows = read_rows(path, header)
    gaussians = unpack(rows, path) if packed else _unpacked(rows["vertex"], path)
    kind = "compressed PLY" if packed else "PLY"
    return SplatFile((checked(gaussians, path),), _antialiased(header.comments), kind=kind)


def read_header(path: Path) -> Ply:
    """The header of a file.

    Raises:
        InputError: it has none.
    """
    with path.open("rb") as file:
        head = file.read(HEADER_MAX)
    if not head.startswith((b"ply\n", b"ply\r\n")):
        raise InputError(path, "header", found=head[:4], expected="ply")
    text, mark, _ = head.partition(b"end_header")
    end = head.find(b"\n", len(text))
    if not mark or end < 0:
        raise InputError(path, "header", found=f"no end in {len(head):,} bytes", expected="one")
    order, comments, elements = None, list[str](), dict[str, Element]()
    element: Element | None = None
    for line in text.decode("latin-1").splitlines()[1:]:
        words = line.split()
        match words:
            case []:
                pass
            case ["format", name, *_]:
                order = ORDERS.get(name)
            case ["comment" | "obj_info", *_]:
                comments.append(line.partition(" ")[2].strip())
            case ["element", name, count] if count.isdecimal() and len(count) < 20:
                element = Element(name, int(count), [])
                elements[name] = element
            case ["property", kind, name] if element and kind in TYPES:
                element.properties.append((name, TYPES[kind]))
            case _:
                raise InputError(path, "header", found=line[:80], expected="a line of a PLY header")
    if order is None:
        raise InputError(path, "header", found="no known format", expected=" or ".join(ORDERS))
    return Ply(order, elements, comments, end + 1)


def read_rows(path: Path, header: Ply) -> dict[str, Array]:
    """The rows of each element, as structured arrays.

    Raises:
        InputError: the file is too short for them, or a name occurs twice.
    """
    size = path.stat().st_size
    kinds: dict[str, np.dtype[Any]] = {}
    for element in header.elements.values():
        try:
            fields = [(name, (header.order or "<") + kind) for name, kind in element.properties]
            kinds[element.name] = np.dtype(fields)
        except ValueError as error:
            raise InputError(path, "header", found=error) from error
    if not header.order:
        return _read_text(path, header, kinds)
    needed = sum(e.count * kinds[e.name].itemsize for e in header.elements.values())
    check_room(size - header.start, needed, path, "rows")
    rows: dict[str, Array] = {}
    at = header.start
    for element in header.elements.values():
        kind = kinds[element.name]
        if element.count and kind.itemsize:
            rows[element.name] = np.memmap(path, kind, "r", at, (element.count,))
        at += element.count * kind.itemsize
    return rows


def _read_text(path: Path, header: Ply, kinds: dict[str, np.dtype[Any]]) -> dict[str, Array]:
    """Rows as decimal numbers, in which each takes two bytes at least."""
    numbers = sum(e.count * len(e.properties) for e in header.elements.values())
    check_room(path.stat().st_size - header.start + 1, 2 * numbers, path, "rows")
    text = path.read_bytes()[header.start :]
    words = text.split()
    if len(words) < numbers:
        raise InputError(path, "rows", found=f"{len(words):,} numbers", expected=f"{numbers:,}")
    rows: dict[str, Array] = {}
    at = 0
    for element in header.elements.values():
        width = len(element.properties)
        part = words[at : at + element.count * width]
        at += len(part)
        try:
            values = np.array(part, np.float64).reshape(element.count, width)
        except ValueError as error:
            raise InputError(path, "rows", found=error, expected="numbers") from error
        table = np.zeros(element.count, kinds[element.name])
        for column, (name, _) in enumerate(element.properties):
            table[name] = values[:, column]
        rows[element.name] = table
    return rows


def _unpacked(rows: Array, path: Path) -> PlainGaussians:
    names = set(rows.dtype.names or ())
    wanted = ["x", "y", "z", "opacity", *(f"scale_{i}" for i in range(3))]
    wanted += [f"rot_{i}" for i in range(4)]
    missing = [name for name in wanted if name not in names]
    if missing:
        advice = "is it a file of points or of a mesh?" if "scale_0" not in names else ""
        found = f"no property {missing[0]}"
        raise InputError(path, "header", found=found, expected="those of 3DGS", advice=advice)
    return PlainGaussians(
        means=columns(rows, ["x", "y", "z"]),
        log_scales=columns(rows, [f"scale_{i}" for i in range(3)]),
        quaternions=columns(rows, [f"rot_{i}" for i in range(4)]),
        logits=columns(rows, ["opacity"])[:, 0],
        sh=_harmonics(rows, names, path),
    )


def columns(rows: Array, names: list[str]) -> Float32:
    """Properties as float32 [rows, names]; what is beyond float32 becomes infinite."""
    with np.errstate(over="ignore"):
        return np.stack([np.asarray(rows[name], np.float32) for name in names], axis=1)


def _harmonics(rows: Array, names: set[str], path: Path) -> Float32:
    """Coefficients [G, C, 3]; those of a file stand colour by colour."""
    rest = sum(name.startswith("f_rest_") for name in names)
    if rest not in HARMONICS:
        expected = " or ".join(map(str, HARMONICS))
        raise InputError(path, "header", found=f"{rest} properties f_rest", expected=expected)
    if {"f_dc_0", "f_dc_1", "f_dc_2"} <= names:
        first = columns(rows, [f"f_dc_{i}" for i in range(3)])
    elif {"red", "green", "blue"} <= names:
        first = (columns(rows, ["red", "green", "blue"]) / np.float32(255) - 0.5) / SH_0
    else:
        raise InputError(path, "header", found="no colours", expected="f_dc_0, f_dc_1 and f_dc_2")
    count = rest // 3
    sh = np.empty((len(rows), 1 + count, 3), np.float32)
    sh[:, 0] = first
    for channel in range(3):
        for i in range(count):
            sh[:, 1 + i, channel] = rows[f"f_rest_{channel * count + i}"]
    return sh


def _antialiased(comments: list[str]) -> bool:
    joined = [comment.lower().replace(" ", "") for comment in comments]
    return any(text.startswith(RENDER_MODE) and "mip" in text for text in joined)
