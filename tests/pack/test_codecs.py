import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gsynopsis.pack.codecs import CODINGS, CodecError, decode_array, encode_array, inflate
from gsynopsis.pack.layout import CodingId
from gsynopsis.records import morton_order

SHAPES = hnp.array_shapes(min_dims=2, max_dims=2, max_side=9)
INTS = hnp.arrays(np.int32, SHAPES)
POINTS = hnp.arrays(np.int32, st.tuples(st.integers(1, 9), st.just(3)))
NEAR = hnp.arrays(
    np.int32, st.tuples(st.integers(1, 9), st.just(3)), elements=st.integers(-(2**20), 2**20 - 1)
)
FLOATS = hnp.arrays(
    np.float32, SHAPES, elements=st.floats(width=32, allow_nan=False, allow_infinity=False)
)
HALVES = hnp.arrays(np.float32, SHAPES, elements=st.floats(-65500, 65500, width=32))


def there_and_back(coding: CodingId, array: np.ndarray) -> np.ndarray:
    encoded = encode_array(coding, array)
    dtype = array.dtype.str[1:]
    rows, columns = array.shape
    assert encoded.raw == CODINGS[coding].raw_length(rows, columns, array.itemsize)
    decoded = decode_array(coding, encoded.stored, encoded.raw, (rows, columns), dtype)
    assert decoded.dtype == array.dtype
    assert decoded.shape == array.shape
    return decoded


@given(FLOATS)
def test_plain_and_shuffle_keep_every_bit_of_floats(array: np.ndarray) -> None:
    for coding in (CodingId.PLAIN, CodingId.SHUFFLE):
        assert there_and_back(coding, array).tobytes() == array.tobytes()


@given(hnp.arrays(np.uint8, SHAPES))
def test_plain_and_shuffle_keep_bytes(array: np.ndarray) -> None:
    for coding in (CodingId.PLAIN, CodingId.SHUFFLE):
        assert (there_and_back(coding, array) == array).all()


@given(INTS)
def test_delta_is_exact_for_every_int32(array: np.ndarray) -> None:
    assert (there_and_back(CodingId.DELTA, array) == array).all()


@given(NEAR)
def test_morton_is_exact_for_ordered_points_within_21_bits(points: np.ndarray) -> None:
    points = points[morton_order(points)]
    assert CODINGS[CodingId.MORTON].fits(points)
    assert (there_and_back(CodingId.MORTON, points) == points).all()


@given(POINTS)
def test_morton_fits_only_what_it_can_give_back(points: np.ndarray) -> None:
    if CODINGS[CodingId.MORTON].fits(points):
        assert (there_and_back(CodingId.MORTON, points) == points).all()


@pytest.mark.parametrize("low", [-(2**31), 2**31 - 2**21, -(2**20)])
def test_morton_reaches_both_ends_of_int32(low: int) -> None:
    points = np.array([[low] * 3, [low + 2**21 - 1] * 3], np.int64).astype(np.int32)
    assert (there_and_back(CodingId.MORTON, points) == points).all()


def test_morton_does_not_fit_wide_or_unordered_points() -> None:
    fits = CODINGS[CodingId.MORTON].fits
    assert not fits(np.array([[0, 0, 0], [2**21, 0, 0]], np.int32))
    assert not fits(np.array([[-(2**31), 0, 0], [2**31 - 1, 0, 0]], np.int32))
    assert not fits(np.array([[1, 0, 0], [0, 0, 0]], np.int32))
    assert not fits(np.zeros((3, 2), np.int32))


@given(HALVES)
def test_half_stays_within_its_bound_and_reports_the_largest_error(array: np.ndarray) -> None:
    decoded = there_and_back(CodingId.HALF, array).astype(np.float64)
    error = np.abs(decoded - array)
    assert (error <= np.maximum(np.abs(array) * 2.0**-11, 2.0**-25)).all()
    assert error.max() == encode_array(CodingId.HALF, array).error


@given(HALVES)
def test_half_is_exact_the_second_time(array: np.ndarray) -> None:
    once = there_and_back(CodingId.HALF, array)
    assert encode_array(CodingId.HALF, once).error == 0
    assert there_and_back(CodingId.HALF, once).tobytes() == once.tobytes()


def test_half_fits_exactly_what_does_not_become_infinite() -> None:
    fits = CODINGS[CodingId.HALF].fits
    most = np.nextafter(np.float32(65520), np.float32(0))
    assert fits(np.array([[most, -most]], np.float32))
    assert there_and_back(CodingId.HALF, np.array([[most]], np.float32)) == 65504
    assert not fits(np.array([[0, -65520]], np.float32))


@pytest.mark.parametrize("coding", CodingId)
def test_encoding_takes_any_memory_order_and_leaves_it_alone(coding: CodingId) -> None:
    dtype = "i4" if "i4" in CODINGS[coding].dtypes else "f4"
    array = np.arange(12).reshape(4, 3).astype(dtype)
    array.flags.writeable = False
    before = array.tobytes()
    expected = encode_array(coding, array)
    assert encode_array(coding, np.asfortranarray(array)) == expected
    assert encode_array(coding, np.repeat(array, 2, axis=0)[::2]) == expected
    assert array.tobytes() == before


def test_decoded_arrays_do_not_share_the_memory_of_the_bytes() -> None:
    stored = bytearray(encode_array(CodingId.PLAIN, np.ones((2, 2), np.float32)).stored)
    decoded = decode_array(CodingId.PLAIN, stored, 16, (2, 2), "f4")
    stored[:] = bytes(16)
    assert (decoded == 1).all()


@pytest.mark.parametrize(
    ("stored", "length", "found"),
    [
        (zlib.compress(b"abcd"), 3, "more than 3"),
        (zlib.compress(b"abcd"), 5, "4 inflated bytes"),
        (zlib.compress(b"abcd")[:-1], 4, "4 inflated bytes"),
        (zlib.compress(b"abcd") + b"x", 4, "1 bytes after"),
        (b"", 4, "0 inflated bytes"),
        (b"no stream", 4, "no zlib stream"),
        (zlib.compress(b"abcd")[:-1] + b"\0", 4, "no zlib stream"),
    ],
)
def test_a_damaged_zlib_stream_is_refused(stored: bytes, length: int, found: str) -> None:
    with pytest.raises(CodecError, match=found):
        inflate(stored, length)


def test_plain_bytes_of_another_length_are_refused() -> None:
    with pytest.raises(CodecError, match="15 bytes instead of 16"):
        decode_array(CodingId.PLAIN, bytes(15), 16, (2, 2), "f4")


def morton_raw(base: tuple[int, int, int], steps: list[int]) -> bytes:
    planes = np.array(steps, "<u8").view(np.uint8).reshape(len(steps), 8).T.tobytes()
    return zlib.compress(np.array(base, "<i4").tobytes() + planes)


@pytest.mark.parametrize(
    ("base", "steps", "found"),
    [
        ((0, 0, 0), [1 << 63, 0], "Morton code"),
        ((0, 0, 0), [2**63 - 1, 2**64 - 5], "Morton code"),
        ((0, 0, 0), [2**63 - 1, 2], "Morton code"),
        ((2**31 - 1, 0, 0), [0, 1], "coordinate"),
    ],
)
def test_morton_codes_that_no_writer_makes_are_refused(
    base: tuple[int, int, int], steps: list[int], found: str
) -> None:
    with pytest.raises(CodecError, match=found):
        decode_array(CodingId.MORTON, morton_raw(base, steps), 28, (2, 3), "i4")
