"""Arrays to bytes and back: one entry in `CODINGS` per coding, each a pair of pure functions.

Adding a coding is one entry here and one number in `layout.CodingId`. Encoders never touch the
caller's array and say how much they lose; decoders check what they are given. DEFLATE is the
same last step of every coding that wants it.
"""

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gsynopsis.pack.layout import CodingId
from gsynopsis.records import MORTON_BITS, MORTON_STEPS, morton_codes

Array = NDArray[Any]
Bytes = bytes | bytearray | memoryview

HALF_LIMIT = 65520.0
"""The smallest magnitude that float16 rounds to infinity."""
DEFLATE_LEVEL = 9


class CodecError(ValueError):
    """Bytes that no encoder of this coding writes; readers say where they stood."""


@dataclass(frozen=True)
class Coding:
    """How a [rows, columns] array becomes bytes.

    Attributes:
        dtypes: Array types it takes, as NumPy codes.
        deflated: A zlib stream follows as last step.
        raw_length: Bytes before deflating, from rows, columns and bytes per value.
        fits: True if the values can be stored without exceeding the coding's error bound.
        encode: Raw bytes and the largest absolute error of a value.
        decode: The array again, from raw bytes of the right length.
    """

    dtypes: frozenset[str]
    deflated: bool
    raw_length: Callable[[int, int, int], int]
    fits: Callable[[Array], bool]
    encode: Callable[[Array], tuple[bytes, float]]
    decode: Callable[[Bytes, tuple[int, int], str], Array]


@dataclass(frozen=True)
class Encoded:
    """A chunk's bytes as stored, their length before deflating, and the largest error."""

    stored: bytes
    raw: int
    error: float


def encode_array(coding: CodingId, array: Array) -> Encoded:
    """Encode one array [rows, columns] that the coding fits."""
    entry = CODINGS[coding]
    raw, error = entry.encode(array)
    stored = zlib.compress(raw, DEFLATE_LEVEL) if entry.deflated else raw
    return Encoded(stored, len(raw), error)


def decode_array(
    coding: CodingId, stored: Bytes, raw_length: int, shape: tuple[int, int], dtype: str
) -> Array:
    """Decode one array; its raw length was checked against the shape before.

    Raises:
        CodecError: the bytes are not what they are declared to be.
    """
    entry = CODINGS[coding]
    raw = inflate(stored, raw_length) if entry.deflated else stored
    if len(raw) != raw_length:
        raise CodecError(f"{len(raw)} bytes instead of {raw_length}")
    return entry.decode(raw, shape, dtype)


def inflate(stored: Bytes, length: int) -> bytes:
    """Inflate a zlib stream of exactly `length` > 0 bytes, never holding more than one beyond.

    Raises:
        CodecError: the stream is damaged, shorter, longer, or followed by other bytes.
    """
    stream = zlib.decompressobj()
    try:
        raw = stream.decompress(stored, length + 1)
    except zlib.error as error:
        raise CodecError(f"no zlib stream ({error})") from error
    if len(raw) != length or not stream.eof:
        count = f"more than {length}" if len(raw) > length else f"{len(raw)}"
        raise CodecError(f"{count} inflated bytes instead of {length}")
    if stream.unused_data:
        raise CodecError(f"{len(stream.unused_data)} bytes after the end of the zlib stream")
    return raw


def _always(array: Array) -> bool:
    return True


def _same_size(rows: int, columns: int, width: int) -> int:
    return rows * columns * width


def _half_size(rows: int, columns: int, width: int) -> int:
    return rows * columns * 2


def _morton_size(rows: int, columns: int, width: int) -> int:
    return 12 + rows * 8


def _little(array: Array) -> Array:
    return np.ascontiguousarray(array, array.dtype.newbyteorder("<"))


def _shuffle(array: Array) -> bytes:
    """First byte 0 of every row, then byte 1 of every row and so on."""
    planes = _little(array).view(np.uint8).reshape(len(array), -1)
    return planes.T.tobytes()


def _unshuffle(raw: Bytes, shape: tuple[int, int], dtype: str) -> Array:
    planes = np.frombuffer(raw, np.uint8).reshape(-1, shape[0])
    return np.ascontiguousarray(planes.T).view("<" + dtype).reshape(shape)


def _encode_plain(array: Array) -> tuple[bytes, float]:
    return _little(array).tobytes(), 0.0


def _decode_plain(raw: Bytes, shape: tuple[int, int], dtype: str) -> Array:
    return np.frombuffer(raw, "<" + dtype).reshape(shape).copy()  # the bytes are not ours


def _encode_shuffle(array: Array) -> tuple[bytes, float]:
    return _shuffle(array), 0.0


def _fits_half(array: Array) -> bool:
    return bool(np.abs(array).max(initial=0) < HALF_LIMIT)


def _encode_half(array: Array) -> tuple[bytes, float]:
    half = array.astype("<f2")
    error = np.abs(array.astype(np.float64) - half.astype(np.float64)).max(initial=0)
    return _shuffle(half), float(error)


def _decode_half(raw: Bytes, shape: tuple[int, int], dtype: str) -> Array:
    return _unshuffle(raw, shape, "f2").astype(np.float32)


def _encode_delta(array: Array) -> tuple[bytes, float]:
    values = array.astype(np.int32).view(np.uint32)
    step = values.copy()
    step[1:] -= values[:-1]
    sign = (step.view(np.int32) >> 31).view(np.uint32)
    return _shuffle((step << np.uint32(1)) ^ sign), 0.0


def _decode_delta(raw: Bytes, shape: tuple[int, int], dtype: str) -> Array:
    zigzag = _unshuffle(raw, shape, "u4").astype(np.uint32, copy=False)
    step = (zigzag >> np.uint32(1)) ^ (np.uint32(0) - (zigzag & np.uint32(1)))
    return np.cumsum(step, axis=0, dtype=np.uint32).view(np.int32)


def _morton_parts(array: Array) -> tuple[Array, Array]:
    """The smallest coordinate of each axis and the codes counted from there, [3] and [rows]."""
    base = array.min(axis=0)
    return base, morton_codes((array.astype(np.int64) - base).astype(np.uint64))


def _fits_morton(array: Array) -> bool:
    if array.shape[1] != 3 or int(np.ptp(array.astype(np.int64), axis=0).max()) >> MORTON_BITS:
        return False
    codes = _morton_parts(array)[1]
    return bool((codes[1:] >= codes[:-1]).all())


def _encode_morton(array: Array) -> tuple[bytes, float]:
    base, codes = _morton_parts(array)
    codes[1:] -= codes[:-1].copy()
    return base.astype("<i4").tobytes() + _shuffle(codes.reshape(-1, 1)), 0.0


def _decode_morton(raw: Bytes, shape: tuple[int, int], dtype: str) -> Array:
    base = np.frombuffer(raw[:12], "<i4").astype(np.int64)
    steps = _unshuffle(raw[12:], (shape[0], 1), "u8").astype(np.uint64, copy=False)
    codes = np.cumsum(steps[:, 0], dtype=np.uint64)
    if codes[-1] >> np.uint64(3 * MORTON_BITS) or (codes[1:] < codes[:-1]).any():
        raise CodecError("a Morton code above 2^63")
    points = _axes_of(codes).astype(np.int64) + base
    if points.max() > np.iinfo(np.int32).max:
        raise CodecError("a coordinate above 2^31 - 1")
    return points.astype(np.int32)


def _axes_of(codes: Array) -> Array:
    """The inverse of `morton_codes`, uint64 [rows, 3]."""
    axes = codes[:, None] >> np.arange(3, dtype=np.uint64)
    shifts, masks = zip(*reversed(MORTON_STEPS), strict=True)
    axes &= np.uint64(masks[0])
    for shift, mask in zip(shifts, [*masks[1:], (1 << MORTON_BITS) - 1], strict=True):
        axes = (axes | (axes >> np.uint64(shift))) & np.uint64(mask)
    return axes


_FLOAT, _INT = frozenset({"f4"}), frozenset({"i4"})
_EVERY = frozenset({"f4", "i4", "u1"})

CODINGS = {
    CodingId.PLAIN: Coding(_EVERY, False, _same_size, _always, _encode_plain, _decode_plain),
    CodingId.SHUFFLE: Coding(_EVERY, True, _same_size, _always, _encode_shuffle, _unshuffle),
    CodingId.HALF: Coding(_FLOAT, True, _half_size, _fits_half, _encode_half, _decode_half),
    CodingId.DELTA: Coding(_INT, True, _same_size, _always, _encode_delta, _decode_delta),
    CodingId.MORTON: Coding(_INT, True, _morton_size, _fits_morton, _encode_morton, _decode_morton),
}
