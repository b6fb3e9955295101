import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gsynopsis.container.codecs import (
    CodecError,
    deflate,
    from_planes,
    inflate,
    section_sizes,
    to_planes,
)

RAWS = st.binary(max_size=400) | st.builds(lambda n: bytes(n), st.integers(0, 400))


@given(hnp.arrays(np.uint16, hnp.array_shapes(min_dims=2, max_dims=2, max_side=9)))
def test_planes_hold_all_bytes(array: np.ndarray) -> None:
    raw = to_planes(array)
    assert len(raw) == array.nbytes
    assert (from_planes(raw, *array.shape, "<u2") == array).all()
    lowest = raw[: len(array)]
    assert lowest == (array[:, 0] & 255).astype(np.uint8).tobytes()


@given(RAWS, st.lists(st.integers(0, 200), max_size=4))
def test_inflating_undoes_deflating_with_any_sections(raw: bytes, cuts: list[int]) -> None:
    ends = sorted(min(c, len(raw)) for c in cuts)
    sections = np.diff([0, *ends, len(raw)]).tolist()
    stored, sizes = deflate(raw, sections)
    assert bytes(inflate(stored, len(raw))) == raw
    assert sum(sizes) == len(stored) <= len(raw)
    assert sum(section_sizes(stored, sections)) == len(stored)


def deflated(raw: bytes) -> bytes:
    return zlib.compress(raw, 9)[2:-4]


@pytest.mark.parametrize(
    ("stored", "length", "found"),
    [
        (deflated(bytes(9)), 8, "more than 8"),
        (deflated(bytes(9)), 10, "9 inflated bytes"),
        (deflated(bytes(90))[:-1], 90, "inflated bytes instead of 90"),
        (deflated(bytes(9)) + b"x", 9, "1 bytes after"),
        (b"", 4, "0 inflated bytes"),
        (b"no stream", 40, "no DEFLATE stream"),
    ],
)
def test_a_damaged_stream_is_refused(stored: bytes, length: int, found: str) -> None:
    with pytest.raises(CodecError, match=found):
        inflate(stored, length)


def test_section_sizes_refuse_a_stream_of_another_length() -> None:
    with pytest.raises(CodecError, match="9 inflated bytes instead of 10"):
        section_sizes(deflated(bytes(9)), [10, 3])
    with pytest.raises(CodecError, match="no DEFLATE"):
        section_sizes(b"no stream", [10, 3])
