"""Arrays of floating-point values to bytes and back: one branch for each coding.

Encoders never touch the caller's array; decoders check what they are given.

A step has five significant bits and every stored value is a multiple of it (or of a 64th) that
float32 holds without rounding. An array that was decoded from a coding, or rounded to steps of
another length (`rounding`), therefore has values that the coding finds again: nothing changes.
"""

import math
from collections.abc import Mapping
from functools import cache

import numpy as np
from numpy.typing import NDArray

from gsynopsis.container.codecs import Array, Bytes, NotFiniteError, from_planes, to_planes
from gsynopsis.container.layout import CodingId
from gsynopsis.records import Float32

HALF_LIMIT = 65520.0
"""The smallest magnitude that float16 rounds to infinity."""
TYPES = {
    CodingId.FLOAT: "<f4",
    CodingId.HALF: "<f2",
    CodingId.AFFINE8: "|u1",
    CodingId.AFFINE16: "<u2",
    CodingId.CURVE8: "|u1",
}
STEPPED = frozenset({CodingId.AFFINE8, CodingId.AFFINE16, CodingId.CURVE8})
TOP = {CodingId.AFFINE8: 255.0, CodingId.AFFINE16: 65535.0, CodingId.CURVE8: 127 + 127 * 127 / 64}
"""Steps from `low` to the largest value that can be stored."""
BOTTOM = {CodingId.AFFINE8: 0.0, CodingId.AFFINE16: 0.0, CodingId.CURVE8: -384.0}
CENTRE = 128
"""The number of `low` in curve8."""
PARAMETER_BYTES = 8
"""Bytes of a stepped column's `low` and `step`, float32."""
STEP_BITS = 5
STEPS_TRIED = 1 << (STEP_BITS - 1)
"""Steps there are from one power of two to the next."""
OCTAVES = (-5, 8)
"""Powers of two from the smallest step worth taking at which the steps of a rounded column are
looked for."""
SAMPLE = 16
"""Values by which most steps are ruled out."""
MULTIPLES = 1 << 18
"""A count below this, times a step, has at most 24 bits."""
TINY_STEP = 2.0**-120
LARGEST = float(np.finfo(np.float32).max)
_OFFSET = np.arange(256, dtype=np.float64) - CENTRE
CURVE = _OFFSET + _OFFSET * np.abs(_OFFSET) / 64
"""Steps away from `low` by number: fine near it, five times as coarse at the ends."""


def values_bytes(coding: CodingId, rows: int, columns: int) -> int:
    """Bytes of an encoded [rows, columns] array before deflating; 0 if it is empty."""
    if not rows * columns:
        return 0
    parameters = PARAMETER_BYTES * columns if coding in STEPPED else 0
    return parameters + rows * columns * np.dtype(TYPES[coding]).itemsize


def encode_values(coding: CodingId, array: Float32, least: float = 0.0) -> bytes:
    """The bytes of a finite float32 [rows, columns] array; nothing for an empty one.

    Args:
        coding: How.
        array: What.
        least: Stepped codings: the smallest step worth taking. 0 uses all numbers there are.

    Raises:
        NotFiniteError: a value is not finite, or too large for float16.
    """
    if not array.size:
        return b""
    if not np.isfinite(array).all():
        raise NotFiniteError(f"{array[~np.isfinite(array)][0]}")
    if coding in STEPPED:
        columns = [_encode_column(coding, column, least) for column in array.T]
        parameters = np.array([(low, step) for low, step, _ in columns], "<f4")
        numbers = np.stack([number for _, _, number in columns], axis=1)
        return parameters.tobytes() + to_planes(numbers.astype(TYPES[coding]))
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
    skip = PARAMETER_BYTES * columns if coding in STEPPED else 0
    numbers = from_planes(raw[skip:], rows, columns, TYPES[coding])
    if coding not in STEPPED:
        values = numbers.astype(np.float32)
        if not np.isfinite(values).all():
            row = int(np.argmin(np.isfinite(values).all(axis=1)))
            raise NotFiniteError(f"{values[row][~np.isfinite(values[row])][0]} in row {row}")
        return values
    with np.errstate(invalid="ignore"):  # what is not finite is refused below, without a warning
        parameters = np.frombuffer(raw[:skip], "<f4").reshape(columns, 2).astype(np.float64)
        low, step = parameters[:, 0], parameters[:, 1]
        ends = np.abs([low + step * BOTTOM[coding], low + step * TOP[coding]])
    bad = ~((ends <= LARGEST).all(axis=0) & (step >= 0))
    if bad.any():
        column = int(np.argmax(bad))
        raise NotFiniteError(f"low {low[column]} and step {step[column]} in column {column}")
    return _values(coding, numbers, low, step)


def column_steps(coding: CodingId, array: Float32, least: float) -> list[tuple[float, float]]:
    """`low` and step of every column of [rows, columns], as `encode_values` would choose them."""
    return [_encode_column(coding, column, least)[:2] for column in array.T]


def nearest_values(coding: CodingId, column: Array, low: float, step: float) -> Float32:
    """Values that a reader gets of a float64 column in these steps."""
    low, numbers = _numbered(coding, column, low, step)
    return _values(coding, numbers, low, step)


def _values(coding: CodingId, numbers: Array, low: Array | float, step: Array | float) -> Float32:
    """Values of numbers [rows] or [rows, columns]; `low` and `step` for each column."""
    return (low + step * _steps(coding, numbers)).astype(np.float32)


def _encode_column(coding: CodingId, column: Float32, least: float) -> tuple[float, float, Array]:
    """`low`, step and numbers of one column."""
    wide = column.astype(np.float64)
    bottom, top = float(wide.min()), float(wide.max())
    curved = coding is CodingId.CURVE8
    reach = max(-bottom, top) if curved else top - bottom
    fit = reach / TOP[coding]
    for step in _steps_of(coding, wide, max(fit, least * 2.0 ** OCTAVES[0])):
        low, numbers = _numbered(coding, wide, bottom, step)
        if (low + step * _steps(coding, numbers) == wide).all():
            return low, step, numbers
    step = short_step(max(fit, least))
    low, numbers = _numbered(coding, wide, bottom, step)
    while low + step * TOP[coding] < top - step / 2:
        step = short_step(step * (1 + 2**-STEP_BITS))
        low, numbers = _numbered(coding, wide, bottom, step)
    return low, step, numbers


def _steps_of(coding: CodingId, wide: Array, least: float) -> list[float]:
    """Steps not below `least`, the longest first, that some values of a column are numbers of."""
    mantissa, exponent = math.frexp(short_step(least) or 1.0)
    steps = np.ldexp(_grid(round(2 * STEPS_TRIED * mantissa) - STEPS_TRIED), exponent)
    some = np.abs(wide[:: max(1, len(wide) // SAMPLE)])
    # The largest rules out nearly all of them, unless the column was rounded before.
    steps = steps[_is_number(coding, some.max() / steps)]
    if len(steps):
        steps = steps[_is_number(coding, some[:, None] / steps).all(axis=0)]
    return steps[::-1].tolist()


@cache
def _grid(first: int) -> Array:
    """Steps of `OCTAVES` from a mantissa's number on, of exponent 0, ascending."""
    places = first + np.arange(STEPS_TRIED * (OCTAVES[1] - OCTAVES[0]))
    mantissas, exponents = places % STEPS_TRIED + STEPS_TRIED, places // STEPS_TRIED
    return np.ldexp(mantissas, exponents - STEP_BITS)


def _is_number(coding: CodingId, away: Array) -> NDArray[np.bool_]:
    """True where the value `away` steps from zero is that of a number."""
    if coding is not CodingId.CURVE8:
        return np.rint(away) == away
    numbers = _ranks(away)
    return numbers + numbers * numbers / 64 == away


def _ranks(away: Array) -> Array:
    """The number of the value `away` steps from zero, curve8."""
    return np.rint(np.sqrt(1024 + 64 * away) - 32)


def _numbered(coding: CodingId, wide: Array, bottom: float, step: float) -> tuple[float, Array]:
    """`low` and the number of every value for a given step."""
    if coding is CodingId.CURVE8:
        away = np.abs(wide) / (step or 1)
        return 0.0, np.clip(CENTRE + np.copysign(_ranks(away), wide), 1, 255).astype(np.int64)
    count = math.floor(bottom / step + 0.5) if step else 0
    low = count * step if step and abs(count) < MULTIPLES else bottom
    return low, np.clip(np.rint((wide - low) / (step or 1)), 0, TOP[coding]).astype(np.int64)


def _steps(coding: CodingId, numbers: Array) -> Array:
    return CURVE[numbers] if coding is CodingId.CURVE8 else numbers


def short_step(step: float) -> float:
    """The smallest number of `STEP_BITS` significant bits that is not below `step`."""
    if step <= TINY_STEP:
        return TINY_STEP if step > 0 else 0.0
    mantissa, exponent = math.frexp(step)
    return math.ldexp(math.ceil(mantissa * (1 << STEP_BITS)), exponent - STEP_BITS)


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
