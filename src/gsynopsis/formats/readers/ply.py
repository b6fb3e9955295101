"""PLY files of Gaussians: those of 3DGS and of programs that follow it; SuperSplat's packed ones.

Dialects differ in which properties there are, in their types and in the comments: SuperSplat leaves
out normals, Brush and Postshot the harmonics that are not trained, some write half floats, and all
add their own.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import InputError
from gsynopsis.files import open_regular
from gsynopsis.formats.axes import DOWN, Up, parse_up, up_text
from gsynopsis.formats.readers.base import (
    LOG_SCALE_LEAST,
    SplatFile,
    check_count,
    check_room,
    cleaned,
    rest_names,
    shown,
)
from gsynopsis.formats.readers.ply_photo import PHOTO, photo_camera
from gsynopsis.records import SH_0, Float32, PlainGaussians

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
    **dict.fromkeys(("half", "float16"), "f2"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
HALF_TYPES = ("i2", "u2")
"""PLY has no half floats; exporters write their bits as these."""
WANTED = ("chunk", "vertex", "sh", *PHOTO)
RENDER_MODE = "splatrendermode"
"""Comment of Brush and Postshot; `mip` is the anti-aliased renderer."""
UP_COMMENT = re.compile(
    r"(?:vertical[\s_-]*axis|up[\s_-]*(?:axis|vector|direction))\b\s*[:=]?\s*(.*)|up\s*[:=]\s*(.*)",
    re.IGNORECASE,
)
"""`Vertical Axis: z` of nerfstudio, `Vertical axis: 0 0 1` of Brush, and others like them."""
MOVING = re.compile(r"t|time|t_scale|scale_t|trbf_.*|motion_\d+|omega_\d+|rot_r_\d|vel.*|f_t_.*")
"""Properties of splats that move, of 4DGS, SpacetimeGaussians and others."""
COLORS = (("red", "green", "blue"), ("r", "g", "b"))
FULL = {"u1": 255.0, "i1": 127.0, "u2": 65535.0, "i2": 32767.0}
"""White in properties of these types."""
SAMPLE = 1 << 14
"""Rows, evenly spread, that are checked first."""
TEXT_PIECE = 1 << 20
LINE_MOST = 1 << 20
"""Bytes of a line that is passed over."""
WORD_MAX = 64
"""Characters of a number."""
RESOLVED = 1e4
"""Steps of float32 that a scene is large, at least; else it is moved to the origin first."""
Array = NDArray[Any]
Shift = tuple[float, float, float]
NO_SHIFT: Shift = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Element:
    """A kind of rows: its name, how many there are, and name and type of each property.

    A property whose type is "" is a list, of no fixed length; `rows` has the types of its values
    and of its length, which is "" of all others.
    """

    name: str
    count: int
    properties: list[tuple[str, str]]
    rows: list[tuple[str, str, str]]


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

    with open_regular(path) as file, np.errstate(all="ignore"):
        header = read_header(file, path)
        vertex = header.elements.get("vertex")
        if vertex is None:
            raise InputError(path, "header", found="no element vertex", expected="one")
        check_count(vertex.count, path)
        packed = "packed_position" in dict(vertex.properties)
        rows = read_rows(file, path, header)
        up, said, notes = up_of(header.comments)
        if packed:
            gaussians, more, shift = unpack(rows, path), list[str](), NO_SHIFT
        else:
            step = -(-vertex.count // SAMPLE)
            if step > 1:  # a long file of nothing is refused before all of it is read
                cleaned(SplatFile((_unpacked(rows["vertex"][::step], path)[0],)), path, step)
            gaussians, more, shift = _unpacked(rows["vertex"], path)
        kind = "compressed PLY" if packed else "PLY"
        antialiased = _antialiased(header.comments)
        photo, of_photo = photo_camera(rows)
        others = [shown(e.name) for e in header.elements.values() if e.count and e.name not in rows]
        unused = [f"not used: the elements {', '.join(others)}"] if others else []
        notes = (*notes, *more, *of_photo, *unused)
        levels = (gaussians,)
        file = SplatFile(levels, antialiased, up, kind, 0, notes, said, shift, photo)
        return cleaned(file, path)


def read_header(file: BinaryIO, path: Path) -> Ply:
    """The header of a file.

    Raises:
        InputError: it has none.
    """
    head = file.read(HEADER_MAX)
    if not head.startswith((b"ply\n", b"ply\r\n")):
        raise InputError(path, "header", found=head[:4], expected="ply")
    text, mark, _ = head.partition(b"end_header")
    end = head.find(b"\n", len(text))
    if not mark or end < 0:
        raise InputError(path, "header", found=f"no end in {len(head):,} bytes", expected="one")
    # By line feeds alone: UTF-8 in comments has bytes that Python takes for ends of lines.
    lines = [line.split() for line in text.decode("latin-1").split("\n")[1:]]
    order, comments, elements = _parsed([words for words in lines if words], path)
    if order is None:
        raise InputError(path, "header", found="no known format", expected=" or ".join(ORDERS))
    return Ply(order, {element.name: element for element in elements}, comments, end + 1)


def _parsed(lines: list[list[str]], path: Path) -> tuple[str | None, list[str], list[Element]]:
    """Byte order, comments and elements of a header's lines."""
    order, comments, elements = None, list[str](), list[Element]()
    for words in lines:
        match words:
            case ["format", name, *_]:
                order = ORDERS.get(name)
            case ["comment" | "obj_info", *rest]:
                comments.append(" ".join(rest))
            case ["element", name, count] if re.fullmatch("[0-9]{1,19}", count):
                elements.append(Element(name, int(count), [], []))
            case ["property", "list", size, kind, name] if elements and {size, kind} <= {*TYPES}:
                elements[-1].properties.append((name, ""))
                elements[-1].rows.append((name, TYPES[kind], TYPES[size]))
            case ["property", kind, name] if elements and kind in TYPES:
                elements[-1].properties.append((name, TYPES[kind]))
                elements[-1].rows.append((name, TYPES[kind], ""))
            case _:
                found, expected = shown(" ".join(words)), "a line of a PLY header"
                raise InputError(path, "header", found=found, expected=expected)
    names = [element.name for element in elements]
    if len(set(names)) < len(names):
        raise InputError(path, "header", found="two elements of one name", expected="one of each")
    return order, comments, elements


def read_rows(file: BinaryIO, path: Path, header: Ply) -> dict[str, Array]:
    """The rows of the elements that make Gaussians, as structured arrays.

    Raises:
        InputError: the file is too short for them, a name occurs twice, or they have lists.
    """
    header = _without_lists(file, path, header)
    file.seek(0, 2)
    size = file.tell() - header.start
    elements = _needed(header, path)
    kinds = {element.name: _kind(element, header, path) for element in elements}
    if not header.order:
        return _read_text(file, path, header, kinds)
    needed = sum(e.count * kinds[e.name].itemsize for e in elements)
    check_room(size, needed, path, "rows")
    rows: dict[str, Array] = {}
    at = header.start
    for element in elements:
        kind = kinds[element.name]
        if element.name in WANTED and element.count:
            rows[element.name] = np.memmap(file, kind, "r", at, (element.count,))
        at += element.count * kind.itemsize
    return rows


def _without_lists(file: BinaryIO, path: Path, header: Ply) -> Ply:
    """The header from the first element on that makes Gaussians, if lists come before it."""
    names = [element.name for element in header.elements.values()]
    first = next(k for k, name in enumerate(names) if name in WANTED)
    before = [header.elements[name] for name in names[:first]]
    if all(kind for element in before if element.count for _, kind in element.properties):
        return header
    file.seek(header.start)
    for element in before:
        _skip_rows(file, path, element, header.order)
    rest = {name: header.elements[name] for name in names[first:]}
    return header._replace(elements=rest, start=file.tell())


def _skip_rows(file: BinaryIO, path: Path, element: Element, order: str) -> None:
    """Read past the rows of an element, each of which may have another length."""
    for number in range(element.count):
        field = f"{element.name} {number}"
        if not order:
            if not file.readline(LINE_MOST).endswith(b"\n"):
                raise InputError(path, field, found="no end of the line", expected="a row a line")
            continue
        for _, kind, length in element.rows:
            size = 1
            if length:
                width = np.dtype(length).itemsize
                head = file.read(width)
                check_room(len(head), width, path, field)
                size = int(np.frombuffer(head, order + length)[0])
                if size < 0:
                    raise InputError(path, field, found=f"a list of {size}", expected="0 or more")
            file.seek(size * np.dtype(kind).itemsize, 1)


def _needed(header: Ply, path: Path) -> list[Element]:
    """The elements up to the last one that makes Gaussians; empty ones have no rows to skip."""
    elements = [element for element in header.elements.values() if element.count]
    last = max(k for k, element in enumerate(elements) if element.name in WANTED)
    for element in elements[: last + 1]:
        lists = [name for name, kind in element.properties if not kind]
        if lists:
            found = f"a list {shown(lists[0])} in the element {shown(element.name)}"
            raise InputError(path, "header", found=found, expected="splats without lists")
        if not element.properties:
            found = f"no properties of the element {shown(element.name)}"
            raise InputError(path, "header", found=found, expected="those of 3DGS")
    return elements[: last + 1]


def _kind(element: Element, header: Ply, path: Path) -> np.dtype[Any]:
    try:
        return np.dtype([(name, (header.order or "<") + kind) for name, kind in element.properties])
    except ValueError as error:
        raise InputError(path, "header", found=shown(error), expected="names once each") from error


def _read_text(
    file: BinaryIO, path: Path, header: Ply, kinds: dict[str, np.dtype[Any]]
) -> dict[str, Array]:
    """Rows as decimal numbers, each of which takes at least two bytes."""
    elements = [header.elements[name] for name in kinds]
    numbers = sum(e.count * len(e.properties) for e in elements)
    check_room(file.tell() - header.start + 1, 2 * numbers, path, "rows")
    values = _numbers(file, path, header.start, numbers)
    rows: dict[str, Array] = {}
    at = 0
    for element in elements:
        width = len(element.properties)
        part = values[at : at + element.count * width].reshape(element.count, width)
        at += part.size
        if element.name in WANTED:
            table = np.zeros(element.count, kinds[element.name])
            for column, (name, _) in enumerate(element.properties):
                table[name] = part[:, column]
            rows[element.name] = table
    return rows


def _numbers(file: BinaryIO, path: Path, start: int, count: int) -> NDArray[np.float64]:
    """The first numbers of a text [count], read in pieces."""
    values = np.empty(0)
    file.seek(start)
    done, rest = 0, b""
    while done < count:
        piece = file.read(TEXT_PIECE)
        words = (rest + piece).split()
        # The last word may go on in the next piece.
        open_end = bool(piece) and not piece[-1:].isspace()
        rest = words.pop() if open_end and words else b""
        if not piece and not words:
            raise InputError(path, "rows", found=f"{done:,} numbers", expected=f"{count:,}")
        words = words[: count - done]
        try:
            if len(rest) > WORD_MAX:
                raise ValueError(f"a word of more than {WORD_MAX} characters")
            found = np.array(words, np.float64)
        except ValueError as error:
            raise InputError(path, "rows", found=shown(error), expected="numbers") from error
        # The count is believed when there is a piece of numbers.
        values = values if len(values) else np.empty(count)
        values[done : done + len(found)] = found
        done += len(found)
    return values


def up_of(comments: list[str]) -> tuple[Up, bool, tuple[str, ...]]:
    """Up as a header's comments have it, else that of 3DGS; if it is said; and a line on it."""
    matches = [(text, UP_COMMENT.fullmatch(text)) for text in comments]
    found = [(text, match[1] or match[2] or "") for text, match in matches if match]
    if not found:
        return DOWN, False, ()
    text, value = found[-1]
    up = parse_up(value)
    if up is None:
        line = f"not understood: the comment '{shown(text)}'; up is taken as {up_text(DOWN)}"
        return DOWN, False, (line,)
    return up, True, (f"up is {up_text(up)}, as the header says ('{shown(text)}')",)


def _unpacked(rows: Array, path: Path) -> tuple[PlainGaussians, list[str], Shift]:
    names = set(rows.dtype.names or ())
    flat = "scale_1" in names and "scale_2" not in names
    sizes = [f"scale_{i}" for i in range(2 if flat else 3)]
    wanted = ["x", "y", "z", "opacity", *sizes]
    wanted += [f"rot_{i}" for i in range(4)]
    missing = [name for name in wanted if name not in names]
    if missing:
        advice = "is it a file of points or of a mesh?" if "scale_0" not in names else ""
        found = f"no property {missing[0]}"
        raise InputError(path, "header", found=found, expected="those of 3DGS", advice=advice)
    rest = rest_names(names, path)
    # Where positions are half floats colours are as well; else they are whole numbers of 16 bits.
    halves = rows.dtype["x"].str[1:] in HALF_TYPES
    colors = [name for group in COLORS for name in group] if halves else []
    rows = _floats(rows, [*wanted, *FIRST, *rest, *colors], path)
    means, told, shift = _means(rows)
    if halves:
        told.append("properties of 16 bits are read as half floats")
    if rest and rest[0] != "f_rest_0":
        told.append(f"harmonics are numbered from {rest[0]} on")
    if moving := sorted(name for name in names if MOVING.fullmatch(name)):
        listed = ", ".join(moving[:3])
        told.append(f"splats move ({shown(listed)}): read as they are at rest, without that")
    if flat:
        told.append("two scales for each splat (2DGS): they are flat, across their third axis")
    log_scales = columns(rows, sizes)
    thin = np.full((len(rows), 3 - len(sizes)), LOG_SCALE_LEAST, np.float32)
    gaussians = PlainGaussians(
        means=means,
        log_scales=np.concatenate([log_scales, thin], axis=1) if flat else log_scales,
        quaternions=columns(rows, [f"rot_{i}" for i in range(4)]),
        logits=columns(rows, ["opacity"])[:, 0],
        sh=_harmonics(rows, rest, path),
    )
    return gaussians, told, shift


FIRST = [f"f_dc_{i}" for i in range(3)]


def _floats(rows: Array, names: list[str], path: Path) -> Array:
    """The same rows with integers of 16 bits as the half floats whose bits they are.

    Raises:
        InputError: a property is of another type of integers.
    """
    found = dict[str, np.dtype[Any]]()
    for name in rows.dtype.names or ():
        kind = rows.dtype[name]
        if name in names and kind.kind != "f":
            if kind.str[1:] not in HALF_TYPES:
                expected = "float, double, or half floats as ushort"
                raise InputError(
                    path, name, found=f"whole numbers ({kind.name})", expected=expected
                )
            kind = np.dtype(kind.str[0] + "f2")
        found[name] = kind
    return rows.view(np.dtype([*found.items()]))


def _means(rows: Array) -> tuple[Float32, list[str], Shift]:
    """Positions; those of doubles that float32 cannot tell apart are moved to the origin first."""
    axes = ["x", "y", "z"]
    if all(rows.dtype[name].itemsize < 8 for name in axes):
        return columns(rows, axes), [], NO_SHIFT
    means = np.stack([np.asarray(rows[name], np.float64) for name in axes], axis=1)
    good = means[np.isfinite(means).all(axis=1)]
    if not len(good):
        return means.astype(np.float32), [], NO_SHIFT
    middle = np.median(good, axis=0)
    size = float(np.median(np.abs(good - middle).max(axis=1)))
    if size > RESOLVED * float(np.spacing(np.abs(middle).max().astype(np.float32))):
        return means.astype(np.float32), [], NO_SHIFT
    x, y, z = (float(value) for value in np.round(middle))
    told = f"moved by minus ({x:.15g} {y:.15g} {z:.15g}), which float32 needs"
    return (means - (x, y, z)).astype(np.float32), [told], (x, y, z)


def columns(rows: Array, names: list[str]) -> Float32:
    """Properties as float32 [rows, names]; values beyond float32 become infinite."""
    with np.errstate(over="ignore"):
        return np.stack([np.asarray(rows[name], np.float32) for name in names], axis=1)


def _harmonics(rows: Array, rest: list[str], path: Path) -> Float32:
    """Coefficients [G, C, 3]; those of a file stand colour by colour."""
    count = len(rest) // 3
    sh = np.empty((len(rows), 1 + count, 3), np.float32)
    sh[:, 0] = _first(rows, path)
    for channel in range(3):
        for i in range(count):
            sh[:, 1 + i, channel] = rows[rest[channel * count + i]]
    return sh


def _first(rows: Array, path: Path) -> Float32:
    """First coefficients: the file's, else of its colours."""
    names = set(rows.dtype.names or ())
    if set(FIRST) <= names:
        return columns(rows, FIRST)
    for colors in COLORS:
        if set(colors) <= names:
            values = columns(rows, list(colors))
            full = FULL.get(rows.dtype[colors[0]].str[1:])
            if full is None:
                # Floats are from 0 to 1, in a few files from 0 to 255.
                full = 255.0 if values[np.isfinite(values)].max(initial=0) > 8 else 1.0
            return (values / np.float32(full) - np.float32(0.5)) / np.float32(SH_0)
    raise InputError(path, "header", found="no colours", expected="f_dc_0, f_dc_1 and f_dc_2")


def _antialiased(comments: list[str]) -> bool:
    joined = [comment.lower().replace(" ", "") for comment in comments]
    return any(text.startswith(RENDER_MODE) and "mip" in text for text in joined)
