"""Arrays to bytes and back: pure functions, one coding after the other.

A [rows, columns] array becomes byte planes: column by column, and within a column first byte 0 of
every row, then byte 1 and so on. Encoders never touch the caller's array; decoders check what they
are given. DEFLATE is the last step of every chunk.
"""

import math
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gsynopsis.pack.layout import CodingId
from gsynopsis.records import Float32

Array = NDArray[Any]
Bytes = bytes | bytearray | memoryview

HALF_LIMIT = 65520.0
"""The smallest magnitude that float16 rounds to infinity."""
RAW_DEFLATE = -15
"""zlib's name for a DEFLATE stream without header and trailer."""
DEFLATE_LEVEL = 9
TYPES = {
    CodingId.FLOAT: "<f4",
    CodingId.HALF: "<f2",
    CodingId.AFFINE8: "|u1",
    CodingId.AFFINE16: "<u2",
}
STEPS = {CodingId.AFFINE8: 255, CodingId.AFFINE16: 65535}
"""Equal steps between the extremes of a column."""
STEP_BITS = 5
TINY_STEP = 2.0**-126
PARAMETER_BYTES = 8
"""Of an affine column: lowest value and step, float32."""


class CodecError(ValueError):
    """Bytes that no encoder of this coding writes; readers say where they stood."""


class NotFiniteError(CodecError):
    """A value or a parameter that is not finite."""


def values_bytes(coding: CodingId, rows: int, columns: int) -> int:
    """Bytes of an encoded [rows, columns] array before deflating; 0 if it is empty."""
    if not rows * columns:
        return 0
    parameters = PARAMETER_BYTES * columns if coding in STEPS else 0
    return parameters + rows * columns * np.dtype(TYPES[coding]).itemsize


def encode_values(coding: CodingId, array: Float32, least: float = 0.0) -> bytes:
    """The bytes of a finite float32 [rows, columns] array; nothing for an empty one.

    Args:
        coding: How.
        array: What.
        least: Affine codings: the smallest step worth taking. 0 uses all steps there are.

    Raises:
        NotFiniteError: a value is not finite, or too large for float16.
    """
    if not array.size:
        return b""
    if not np.isfinite(array).all():
        raise NotFiniteError(f"{array[~np.isfinite(array)][0]}")
    if coding in STEPS:
        low, step = affine_parameters(array, STEPS[coding], least)
        wide = array.astype(np.float64) - low
        level = np.clip(np.rint(wide / np.where(step > 0, step, 1)), 0, STEPS[coding])
        parameters = np.stack([low, step], axis=1).astype("<f4").tobytes()
        return parameters + to_planes(level.astype(TYPES[coding]))
    if coding is CodingId.HALF and np.abs(array).max() >= HALF_LIMIT:
        raise NotFiniteError(f"{np.abs(array).max()} in float16")
    return to_planes(array.astype(TYPES[coding]))


def decode_values(coding: CodingId, raw: Bytes, rows: int, columns: int) -> Float32:
    """The float32 [rows, columns] array in bytes of the right length.

    Raises:
        NotFiniteError: a value is not finite.
    """
    if not rows * columns:
        return np.zeros((rows, columns), np.float32)
    skip = PARAMETER_BYTES * columns if coding in STEPS else 0
    levels = from_planes(raw[skip:], rows, columns, TYPES[coding])
    if coding not in STEPS:
        values = levels.astype(np.float32)
        if not np.isfinite(values).all():
            row = int(np.argmin(np.isfinite(values).all(axis=1)))
            raise NotFiniteError(f"{values[row][~np.isfinite(values[row])][0]} in row {row}")
        return values
    parameters = np.frombuffer(raw[:skip], "<f4").reshape(columns, 2).astype(np.float64)
    low, step = parameters[:, 0], parameters[:, 1]
    highest = low + step * STEPS[coding]
    bad = ~(np.isfinite(highest) & (step >= 0) & (np.abs(highest) < np.finfo(np.float32).max))
    if bad.any():
        column = int(np.argmax(bad))
        raise NotFiniteError(f"low {low[column]} and step {step[column]} in column {column}")
    return (low + step * levels).astype(np.float32)


def affine_parameters(array: Float32, steps: int, least: float) -> tuple[Array, Array]:
    """Lowest value and step of each column, float64 [columns] that are exact in float32.

    A step has five significant bits and the lowest value is a multiple of it wherever float32
    allows, so every decoded value is a multiple of the step, without rounding. A column that
    already is such multiples keeps its values: coding what was decoded changes nothing.
    """
    low, high = array.min(axis=0).astype(np.float64), array.max(axis=0).astype(np.float64)
    lows, found = np.empty_like(low), np.empty_like(low)
    for column, (least_value, most) in enumerate(zip(low, high, strict=True)):
        step = _short_step(max((most - least_value) / steps, least))
        while step and math.floor(least_value / step + 0.5) * step + step * steps < most - step / 2:
            step = _short_step(step * (1 + 2**-STEP_BITS))
        found[column] = _exact_step(array[:, column], step, steps)
        step = found[column]
        count = math.floor(least_value / step + 0.5) if step else 0
        lows[column] = count * step if step and abs(count) < 1 << 18 else least_value
    return lows.astype(np.float32).astype(np.float64), found


def _short_step(step: float) -> float:
    """The smallest number of `STEP_BITS` significant bits that is not below `step`."""
    if step <= TINY_STEP:
        return TINY_STEP if step > 0 else 0.0
    mantissa, exponent = math.frexp(step)
    return math.ldexp(math.ceil(mantissa * (1 << STEP_BITS)), exponent - STEP_BITS)


def _exact_step(values: Float32, step: float, steps: int) -> float:
    """The finest step from `step` to its double of which all values are multiples, else `step`."""
    candidate = step
    while step and candidate <= 2 * step:
        for part in (values[:64], values):
            count = part / np.float64(candidate)
            if not (count == np.rint(count)).all():
                break
        else:
            return candidate
        candidate = _short_step(candidate * (1 + 2**-STEP_BITS))
    return step


def network_bytes(coding: CodingId, shapes: Mapping[str, tuple[int, ...]]) -> int:
    """Bytes of all weights, each matrix or bias as one column."""
    return sum(values_bytes(coding, math.prod(shape), 1) for shape in shapes.values())


def encode_networks(coding: CodingId, weights: Mapping[str, Float32], least: float = 0.0) -> bytes:
    """The bytes of all weights in their order."""
    return b"".join(encode_values(coding, w.reshape(-1, 1), least) for w in weights.values())


def decode_networks(
    coding: CodingId, raw: Bytes, shapes: Mapping[str, tuple[int, ...]]
) -> dict[str, Float32]:
    """All weights by name."""
    weights: dict[str, Float32] = {}
    at = 0
    for name, shape in shapes.items():
        count = math.prod(shape)
        length = values_bytes(coding, count, 1)
        weights[name] = decode_values(coding, raw[at : at + length], count, 1).reshape(shape)
        at += length
    return weights


def to_planes(array: Array) -> bytes:
    """Byte planes of a [rows, columns] array, column by column, lowest byte first."""
    little = np.ascontiguousarray(array.T, array.dtype.newbyteorder("<"))
    width = array.dtype.itemsize
    if width == 1:
        return little.tobytes()
    planes = little.view(np.uint8).reshape(array.shape[1], len(array), width)
    return np.ascontiguousarray(planes.transpose(0, 2, 1)).tobytes()


def from_planes(raw: Bytes, rows: int, columns: int, dtype: str) -> Array:
    """The inverse of `to_planes`; a view where a value is one byte."""
    width = np.dtype(dtype).itemsize
    planes = np.frombuffer(raw, np.uint8).reshape(columns, width, rows)
    if width == 1:
        return planes[:, 0].T.view(dtype)
    return np.ascontiguousarray(planes.transpose(2, 0, 1)).view(dtype).reshape(rows, columns)


def deflate(raw: bytes, sections: Sequence[int] = ()) -> tuple[bytes, list[int]]:
    """A DEFLATE stream of the bytes, or the bytes themselves where that is not shorter.

    Args:
        raw: What to deflate.
        sections: Lengths of the pieces whose statistics differ: each gets its own Huffman tables.

    Returns:
        What to store, and how many bytes of it each section takes, to the nearest byte.
    """
    sections = sections or (len(raw),)
    coder = zlib.compressobj(DEFLATE_LEVEL, zlib.DEFLATED, RAW_DEFLATE, 9)
    pieces: list[bytes] = []
    view, at = memoryview(raw), 0
    for length in sections:
        piece = coder.compress(view[at : at + length])
        at += length
        if length and at < len(raw):
            piece += coder.flush(zlib.Z_BLOCK)
        pieces.append(piece)
    pieces[-1] += coder.flush()
    stored = b"".join(pieces)
    if len(stored) < len(raw):
        return stored, [len(piece) for piece in pieces]
    return raw, list(sections)


def inflate(stored: Bytes, length: int) -> Bytes:
    """The bytes behind `deflate`, exactly `length` of them, never holding more than one beyond.

    Raises:
        CodecError: the stream is damaged, shorter, longer, or followed by other bytes.
    """
    if len(stored) == length:
        return stored
    stream = zlib.decompressobj(RAW_DEFLATE)
    try:
        raw = stream.decompress(stored, length + 1)
    except zlib.error as error:
        raise CodecError(f"no DEFLATE stream ({error})") from error
    if len(raw) != length or not stream.eof:
        count = f"more than {length}" if len(raw) > length else f"{len(raw)}"
        raise CodecError(f"{count} inflated bytes instead of {length}")
    if stream.unused_data:
        raise CodecError(f"{len(stream.unused_data)} bytes after the end of the DEFLATE stream")
    return raw


def section_sizes(stored: bytes, sections: Sequence[int]) -> list[int]:
    """How many stored bytes hold each of the raw bytes' sections, to a few bytes.

    Raises:
        CodecError: there is no DEFLATE stream of that length.
    """
    if len(stored) == sum(sections):
        return list(sections)
    stream, rest, sizes = zlib.decompressobj(RAW_DEFLATE), stored, list[int]()
    try:
        for length in sections:
            done = stream.decompress(rest, length) if length else b""
            if len(done) != length:
                raise CodecError(f"{len(done)} inflated bytes instead of {length}")
            left = stream.unconsumed_tail if length else rest
            sizes.append(len(rest) - len(left))
            rest = left
    except zlib.error as error:
        raise CodecError(f"no DEFLATE stream ({error})") from error
    sizes[-1] += len(rest)
    return sizes
