import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gsynopsis.container.codecs import NotFiniteError
from gsynopsis.container.layout import CodingId
from gsynopsis.container.values import (
    CURVE,
    STEPPED,
    decode_values,
    encode_values,
    short_step,
    values_bytes,
)

SHAPES = hnp.array_shapes(min_dims=2, max_dims=2, min_side=0, max_side=9)
LEAST = st.sampled_from([0.0, 1e-3, 0.02, 5.0])
STEPPED_SORTED = sorted(STEPPED)


def floats(limit: float) -> st.SearchStrategy[np.ndarray]:
    return hnp.arrays(np.float32, SHAPES, elements=st.floats(-limit, limit, width=32))


def there_and_back(coding: CodingId, array: np.ndarray, least: float = 0.0) -> np.ndarray:
    raw = encode_values(coding, array, least)
    assert len(raw) == values_bytes(coding, *array.shape)
    decoded = decode_values(coding, raw, *array.shape)
    assert decoded.dtype == np.float32
    assert decoded.shape == array.shape
    return decoded


@given(floats(float(np.finfo(np.float32).max)))
def test_float_keeps_every_bit(array: np.ndarray) -> None:
    assert there_and_back(CodingId.FLOAT, array).tobytes() == array.tobytes()


@given(floats(65500))
def test_half_stays_within_its_bound(array: np.ndarray) -> None:
    decoded = there_and_back(CodingId.HALF, array).astype(np.float64)
    assert (np.abs(decoded - array) <= np.maximum(np.abs(array) * 2.0**-11, 2.0**-25)).all()


@given(st.sampled_from(STEPPED_SORTED), floats(2.0**100), LEAST)
def test_what_was_decoded_keeps_its_values(
    coding: CodingId, array: np.ndarray, least: float
) -> None:
    once = there_and_back(coding, array, least)
    assert there_and_back(coding, once, least).tobytes() == once.tobytes()


@given(st.sampled_from(STEPPED_SORTED), floats(1024), LEAST)
def test_stepped_codings_stay_within_their_bounds(
    coding: CodingId, array: np.ndarray, least: float
) -> None:
    raw = encode_values(coding, array, least)
    decoded = decode_values(coding, raw, *array.shape)
    for column in range(array.shape[1] if len(array) else 0):
        step = struct.unpack_from("<f", raw, 8 * column + 4)[0]
        assert short_step(step) == step
        bound = (2.5 if coding is CodingId.CURVE8 else 0.5) * step + 1e-4
        assert np.abs(decoded[:, column].astype(np.float64) - array[:, column]).max() <= bound


def test_the_curve_is_fine_in_the_middle_and_symmetric() -> None:
    assert CURVE[128] == 0
    assert (CURVE[1:] == -CURVE[:0:-1]).all()
    steps = np.diff(CURVE)
    assert steps.min() == CURVE[129] == 1 + 1 / 64
    assert CURVE[255] == 127 + 127 * 127 / 64


@pytest.mark.parametrize("coding", CodingId)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_value_that_is_not_finite_is_not_encoded(coding: CodingId, value: float) -> None:
    with pytest.raises(NotFiniteError):
        encode_values(coding, np.array([[1, value]], np.float32))


def test_what_float16_cannot_hold_is_not_encoded() -> None:
    with pytest.raises(NotFiniteError, match=r"65520\.0 in float16"):
        encode_values(CodingId.HALF, np.array([[0, -65520]], np.float32))


@pytest.mark.parametrize(
    ("coding", "raw"),
    [
        (CodingId.FLOAT, struct.pack("<f", np.inf)),
        (CodingId.HALF, struct.pack("<e", np.nan)),
        (CodingId.AFFINE8, struct.pack("<ffB", np.nan, 1, 0)),
        (CodingId.AFFINE8, struct.pack("<ffB", 0, -1, 0)),
        (CodingId.AFFINE8, struct.pack("<ffB", 0, 3e38, 0)),
        (CodingId.AFFINE16, struct.pack("<ffH", 0, 1e36, 0)),
        (CodingId.CURVE8, struct.pack("<ffB", 0, np.inf, 128)),
        (CodingId.CURVE8, struct.pack("<ffB", -3e38, 1e36, 128)),
    ],
)
def test_numbers_that_are_or_could_become_infinite_are_refused(
    coding: CodingId, raw: bytes
) -> None:
    with pytest.raises(NotFiniteError):
        decode_values(coding, raw, 1, 1)


@pytest.mark.parametrize("coding", CodingId)
def test_encoding_takes_any_memory_order_and_leaves_it_alone(coding: CodingId) -> None:
    array = np.arange(12, dtype=np.float32).reshape(4, 3)
    array.flags.writeable = False
    expected = encode_values(coding, array)
    assert encode_values(coding, np.asfortranarray(array)) == expected
    assert encode_values(coding, np.repeat(array, 2, axis=0)[::2]) == expected


def test_decoded_arrays_do_not_share_the_memory_of_the_bytes() -> None:
    for coding in CodingId:
        raw = bytearray(encode_values(coding, np.ones((2, 2), np.float32)))
        decoded = decode_values(coding, raw, 2, 2)
        before = decoded.copy()
        raw[:] = bytes(len(raw))
        assert (decoded == before).all()
