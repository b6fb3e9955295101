"""SPZ, versions 2 to 4, Niantic's compressed Gaussians: one gzip, or in version 4 zstd streams.

Axes are right, up, back: y is up. They are kept as they are, and noted.
"""

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import InputError, MissingExtraError
from gsynopsis.formats.readers.base import (
    UP,
    SplatFile,
    check_count,
    check_room,
    checked,
    logits_of,
)
from gsynopsis.formats.readers.packed import from_smallest
from gsynopsis.records import HARMONICS, Float32, PlainGaussians

MAGIC = b"NGSP"
GZIP = b"\x1f\x8b"
HEAD = struct.Struct("<4sIIBBBB")
"""Magic, version, count, degree, bits of fractions, flags, and in version 4 streams."""
HEAD_4 = 32
VERSIONS = (2, 3, 4)
SMALLEST_THREE = 3
"""From this version on rotations are the three smallest parts."""
ANTIALIASED = 1
EXPANSION = 1032
"""DEFLATE makes no more of a byte; of zstd more is not believed."""
COLOR_SCALE = 0.15
BITS_MAX = 23

Bytes = NDArray[np.uint8]


@dataclass(frozen=True)
class SpzHeader:
    """What the first bytes say."""

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
        return [self.count * width for width in (9, 1, 3, 3, turn, HARMONICS[self.degree])]


def read_spz(path: Path) -> SplatFile:
    """The Gaussians of an SPZ file.

    Raises:
        InputError: it is damaged, of another version or too large.
        MissingExtraError: it is of version 4 and zstandard is not installed.
    """
    data = path.read_bytes()
    if data.startswith(MAGIC):
        header = _header(data, path, len(data))
        parts = _streams(data, header, path)
    else:
        stream = zlib.decompressobj(16 + zlib.MAX_WBITS)
        try:
            head = stream.decompress(data, HEAD.size)
            header = _header(head, path, len(data))
            total = sum(header.sizes)
            body = stream.decompress(stream.unconsumed_tail, total + 1)
        except zlib.error as error:
            raise InputError(path, "gzip", found=error, expected="an SPZ file") from error
        check_room(len(body), total, path, "gzip")
        parts, at = list[Bytes](), 0
        for size in header.sizes:
            parts.append(np.frombuffer(body, np.uint8, size, at))
            at += size
    gaussians = checked(_gaussians(header, parts), path)
    antialiased = bool(header.flags & ANTIALIASED)
    return SplatFile((gaussians,), antialiased, UP, f"SPZ {header.version}")


def _header(data: bytes, path: Path, stored: int) -> SpzHeader:
    """A header that the file can keep."""
    if len(data) < HEAD.size or data[:4] != MAGIC:
        raise InputError(path, "header", found=data[:4], expected=MAGIC)
    header = SpzHeader(*HEAD.unpack_from(data)[1:])
    zipped = not (header.version >= 4)
    if header.version not in VERSIONS or zipped == (stored == len(data)):
        expected = "2 to 4, the first two in a gzip"
        raise InputError(path, "version", found=header.version, expected=expected)
    check_count(header.count, path)
    if header.degree >= len(HARMONICS):
        raise InputError(path, "degree", found=header.degree, expected="0 to 3")
    if header.fraction > BITS_MAX:
        expected = f"0 to {BITS_MAX}"
        raise InputError(path, "bits of fractions", found=header.fraction, expected=expected)
    check_room(stored * EXPANSION, sum(header.sizes), path, "header")
    return header


def _streams(data: bytes, header: SpzHeader, path: Path) -> list[Bytes]:
    """The attributes of version 4, each its own zstd stream, listed in a table."""
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
        try:
            body = zstandard.ZstdDecompressor().decompress(
                data[at : at + stored], max_output_size=size
            )
        except zstandard.ZstdError as error:
            raise InputError(path, f"stream {number}", found=error, expected="zstd") from error
        if len(body) != size:
            raise InputError(path, f"stream {number}", found=f"{len(body)} bytes", expected=size)
        parts.append(np.frombuffer(body, np.uint8))
        at += stored
    return [*parts, *[np.zeros(0, np.uint8)] * (len(header.sizes) - len(parts))]


def _gaussians(header: SpzHeader, parts: list[Bytes]) -> PlainGaussians:
    count = header.count
    positions, opacities, colors, scales, turn, rest = (
        part.reshape(count, -1) if len(part) else np.zeros((count, 0), np.uint8) for part in parts
    )
    bytes_of = positions.reshape(count, 3, 3).astype(np.int32)
    fixed = bytes_of[..., 0] | bytes_of[..., 1] << 8 | bytes_of[..., 2] << 16
    fixed -= (fixed & 0x800000) << 1
    first = (colors / np.float32(255) - np.float32(0.5)) / np.float32(COLOR_SCALE)
    harmonics = (rest.astype(np.float32).reshape(count, rest.shape[1] // 3, 3) - 128) / 128
    return PlainGaussians(
        means=(fixed / float(1 << header.fraction)).astype(np.float32),
        log_scales=(scales.astype(np.float32) / 16 - 10).astype(np.float32),
        quaternions=_rotations(turn, header),
        logits=logits_of(opacities[:, 0] / 255.0),
        sh=np.concatenate([first[:, None], harmonics], axis=1).astype(np.float32),
    )


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
