"""SPZ, versions 1 to 4, Niantic's compressed Gaussians: one gzip, or in version 4 zstd streams.

Axes are right, up, back: y is up, and `up` says so; a file of other axes says them in a record.
"""

import struct
import zlib
from dataclasses import dataclass
from mmap import ACCESS_READ, mmap
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import InputError, MissingExtraError
from gsynopsis.files import open_regular
from gsynopsis.formats.axes import UP, mirrored, quaternion_of, turned
from gsynopsis.formats.readers.base import (
    SplatFile,
    check_count,
    check_ratio,
    check_room,
    cleaned,
    logits_of,
)
from gsynopsis.formats.readers.packed import from_smallest
from gsynopsis.records import HARMONICS, Float32, PlainGaussians

MAGIC = b"NGSP"
GZIP = b"\x1f\x8b"
HEAD = struct.Struct("<4sIIBBBB")
"""Magic, version, count, degree, bits of fractions, flags, and in version 4 streams."""
HEAD_4 = 32
VERSIONS = (1, 2, 3, 4)
HALF_FLOATS = 1
"""The version whose positions are half floats."""
SMALLEST_THREE = 3
"""From this version on rotations are the three smallest parts."""
ZSTD = 4
"""From this version on attributes are zstd streams."""
ANTIALIASED, EXTENDED = 1, 2
"""Flags; the second says that records follow, each with a type and a length."""
SYSTEM = 0xADBE0003
"""Type of the record that names the axes."""
SYSTEMS = (
    *("RUB", "LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"),
    *("LBD", "RBD", "LBU", "RBU", "LFD", "RFD", "LFU", "RFU"),
)
"""Axes by number, as words of right, up, back and their opposites; the first stands for none."""
EXTENSIONS_MAX = 1 << 16
"""Bytes of all records."""
REST = (*HARMONICS, 72)
"""Harmonics beyond the first of degree 0 to 4; those of degree 4 are left out."""
EXPANSION = 8
"""A byte of a file becomes no more than this (ours: of scenes 1.5 to 4), beyond `BODY_FREE`."""
BODY_FREE = 1 << 24
WINDOW_MAX = 1 << 27
"""Largest window of zstd; its own programs ask for no more either."""
STORED_SPARE = 1 << 16
"""Bytes that an incompressible stream may take beyond its contents."""
PIECE = 1 << 20
COLOR_SCALE = 0.15
BITS_MAX = 23

Bytes = NDArray[np.uint8]


@dataclass(frozen=True)
class SpzHeader:
    """Header of an SPZ file."""

    version: int
    count: int
    degree: int
    fraction: int
    flags: int
    streams: int

    @property
    def sizes(self) -> list[int]:
        """Bytes of positions, opacities, colours, scales, rotations and harmonics."""
        turn = 4 if self.version >= SMALLEST_THREE else 3
        place = 6 if self.version == HALF_FLOATS else 9
        return [self.count * width for width in (place, 1, 3, 3, turn, REST[self.degree])]


def read_spz(path: Path) -> SplatFile:
    """The Gaussians of an SPZ file.

    Raises:
        InputError: it is damaged, of another version or too large.
        MissingExtraError: it is of version 4 and zstandard is not installed.
    """
    with open_regular(path) as file:
        start = file.read(HEAD_4)
        stored = file.seek(0, 2)
        with mmap(file.fileno(), 0, access=ACCESS_READ) as data:
            if start.startswith(MAGIC):
                header = _header(start, path, stored, zipped=False)
                parts, more = _streams(data, header, path)
            else:
                header, parts, more = _unzipped(data, path)
    gaussians = _gaussians(header, parts)
    notes = list[str]()
    if header.degree >= len(HARMONICS):
        notes.append("harmonics of degree 4 are left out")
    if header.flags & EXTENDED:
        system = _system(more, path)
        gaussians = _with_usual_axes(gaussians, system)
        if system != SYSTEMS[0]:
            notes.append(f"axes of the file are {system}: turned to y up, z back")
    antialiased = bool(header.flags & ANTIALIASED)
    kind = f"SPZ {header.version}"
    return cleaned(SplatFile((gaussians,), antialiased, UP, kind, notes=tuple(notes)), path)


def _system(records: bytes, path: Path) -> str:
    """Axes that the records say, as words of `SYSTEMS`."""
    at = 0
    while at + 8 <= len(records):
        kind, length = struct.unpack_from("<II", records, at)
        if kind == SYSTEM and length >= 4 and at + 12 <= len(records):
            (number,) = struct.unpack_from("<I", records, at + 8)
            if number >= len(SYSTEMS):
                expected = f"0 to {len(SYSTEMS) - 1}"
                raise InputError(path, "coordinate system", found=number, expected=expected)
            return SYSTEMS[number]
        at += 8 + length
    return SYSTEMS[0]


def _with_usual_axes(gaussians: PlainGaussians, system: str) -> PlainGaussians:
    """Gaussians of other axes with x right, y up and z back."""
    ways = {"R": (0, 1), "L": (0, -1), "U": (1, 1), "D": (1, -1), "B": (2, 1), "F": (2, -1)}
    turn = np.zeros((3, 3))
    for column, letter in enumerate(system):
        row, sign = ways[letter]
        turn[row, column] = sign
    if np.linalg.det(turn) < 0:
        gaussians, turn = mirrored(gaussians), turn @ np.diag([1, 1, -1])
    if np.array_equal(turn, np.eye(3)):
        return gaussians
    return turned(gaussians, quaternion_of(turn))


def _header(head: bytes, path: Path, stored: int, *, zipped: bool) -> SpzHeader:
    """A header that the file can keep."""
    if len(head) < HEAD.size or head[:4] != MAGIC:
        raise InputError(path, "header", found=head[:4], expected=MAGIC)
    header = SpzHeader(*HEAD.unpack_from(head)[1:])
    if header.version not in VERSIONS or zipped != (header.version < ZSTD):
        expected = "1 to 4, the first three in a gzip"
        raise InputError(path, "version", found=header.version, expected=expected)
    check_count(header.count, path)
    if header.degree >= len(REST):
        raise InputError(path, "degree", found=header.degree, expected="0 to 4")
    if header.fraction > BITS_MAX:
        expected = f"0 to {BITS_MAX}"
        raise InputError(path, "bits of fractions", found=header.fraction, expected=expected)
    check_ratio(header.count, stored, path)
    check_room(max(BODY_FREE, stored * EXPANSION), sum(header.sizes), path, "header")
    return header


def _unzipped(data: mmap, path: Path) -> tuple[SpzHeader, list[Bytes], bytes]:
    """Header, attributes and records of versions 1 to 3, which follow each other in a gzip."""
    stream = zlib.decompressobj(16 + zlib.MAX_WBITS)
    try:
        body = _inflated(stream, data, HEAD.size)
        header = _header(bytes(body[: HEAD.size]), path, len(data), zipped=True)
        total = HEAD.size + sum(header.sizes)
        records = EXTENSIONS_MAX if header.flags & EXTENDED else 0
        body = _inflated(zlib.decompressobj(16 + zlib.MAX_WBITS), data, total + records)
    except zlib.error as error:
        raise InputError(path, "gzip", found=error, expected="an SPZ file") from error
    check_room(len(body), total, path, "gzip")
    parts, at = list[Bytes](), HEAD.size
    for size in header.sizes:
        parts.append(np.frombuffer(body, np.uint8, size, at))
        at += size
    return header, parts, bytes(body[total:])


def _inflated(stream: "zlib._Decompress", data: mmap, size: int) -> bytearray:
    """The first bytes of a gzip, or all if it has fewer, read in pieces."""
    body, at = bytearray(), 0
    while len(body) < size and not stream.eof and (at < len(data) or stream.unconsumed_tail):
        piece = stream.unconsumed_tail or data[at : at + PIECE]
        at += 0 if stream.unconsumed_tail else len(piece)
        body += stream.decompress(piece, size - len(body))
    return body


def _streams(data: mmap, header: SpzHeader, path: Path) -> tuple[list[Bytes], bytes]:
    """The attributes of version 4, each its own zstd stream, listed in a table; and the records."""
    try:
        import zstandard
    except ModuleNotFoundError as error:
        raise MissingExtraError("zstandard", "formats") from error
    sizes = [size for size in header.sizes if size]
    if header.streams != len(sizes):
        raise InputError(path, "streams", found=header.streams, expected=len(sizes))
    check_room(len(data), HEAD_4, path, "header")
    (table,) = struct.unpack_from("<I", data, HEAD.size)
    at = table + 16 * len(sizes)
    if table < HEAD_4:
        raise InputError(path, "table", found=f"at byte {table}", expected=f"from {HEAD_4} on")
    check_room(len(data), at, path, "table")
    parts: list[Bytes] = []
    for number, size in enumerate(sizes):
        stored, raw = struct.unpack_from("<QQ", data, table + 16 * number)
        if raw != size or stored > len(data) - at:
            found, expected = f"{stored} bytes for {raw}", f"{size} of what is there"
            raise InputError(path, f"stream {number}", found=found, expected=expected)
        # As a stream: a frame says itself how large it is, and would be believed at once.
        unpacker = zstandard.ZstdDecompressor(max_window_size=WINDOW_MAX)
        try:
            with unpacker.stream_reader(data[at : at + min(stored, STORED_SPARE + size)]) as stream:
                body = stream.read(size + 1)
        except zstandard.ZstdError as error:
            raise InputError(path, f"stream {number}", found=error, expected="zstd") from error
        if len(body) != size:
            found = f"{len(body) if len(body) < size else 'more'} bytes"
            raise InputError(path, f"stream {number}", found=found, expected=size)
        parts.append(np.frombuffer(body, np.uint8))
        at += stored
    none = [np.zeros(0, np.uint8)] * (len(header.sizes) - len(parts))
    return [*parts, *none], data[HEAD_4 : min(table, HEAD_4 + EXTENSIONS_MAX)]


def _gaussians(header: SpzHeader, parts: list[Bytes]) -> PlainGaussians:
    count = header.count
    positions, opacities, colors, scales, turn, rest = (
        part.reshape(count, -1) if len(part) else np.zeros((count, 0), np.uint8) for part in parts
    )
    first = (colors / np.float32(255) - np.float32(0.5)) / np.float32(COLOR_SCALE)
    rest = rest[:, : HARMONICS[-1]].astype(np.float32)
    harmonics = (rest.reshape(count, rest.shape[1] // 3, 3) - 128) / 128
    return PlainGaussians(
        means=_positions(positions, header),
        log_scales=(scales.astype(np.float32) / 16 - 10).astype(np.float32),
        quaternions=_rotations(turn, header),
        logits=logits_of(opacities[:, 0] / 255.0),
        sh=np.concatenate([first[:, None], harmonics], axis=1).astype(np.float32),
    )


def _positions(values: Bytes, header: SpzHeader) -> Float32:
    """Positions: half floats, else 24-bit numbers of a unit's parts."""
    if header.version == HALF_FLOATS:
        return np.ascontiguousarray(values).view("<f2").astype(np.float32)
    parts = values.reshape(header.count, 3, 3).astype(np.int32)
    fixed = parts[..., 0] | parts[..., 1] << 8 | parts[..., 2] << 16
    fixed -= (fixed & 0x800000) << 1
    return (fixed / float(1 << header.fraction)).astype(np.float32)


def _rotations(turn: Bytes, header: SpzHeader) -> Float32:
    """Quaternions w x y z; the file has x y z w."""
    if header.version < SMALLEST_THREE:
        xyz = turn.astype(np.float32) / np.float32(127.5) - 1
        w = np.sqrt(np.maximum(0, 1 - np.square(xyz).sum(axis=1)))
        return np.concatenate([w[:, None], xyz], axis=1).astype(np.float32)
    packed = np.ascontiguousarray(turn).view("<u4")[:, 0]
    shifts = np.array([20, 10, 0], np.uint32)
    fields = (packed[:, None] >> shifts) & np.uint32(1023)
    size = (fields & np.uint32(511)) / 511 * 0.5**0.5
    small = np.where(fields >> np.uint32(9), -size, size)
    return from_smallest(small, packed >> np.uint32(30))[:, [3, 0, 1, 2]]
