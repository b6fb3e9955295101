import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gsynopsis.container.blocks import (
    BlockShape,
    column_bytes,
    column_sections,
    decode_lattice,
    encode_lattice,
)
from gsynopsis.container.codecs import CodecError
from gsynopsis.container.layout import CodingId, Column
from gsynopsis.records import morton_order

POINTS = hnp.arrays(np.int32, st.tuples(st.integers(1, 9), st.just(3)))
NEAR = hnp.arrays(
    np.int32, st.tuples(st.integers(1, 9), st.just(3)), elements=st.integers(-(2**20), 2**20 - 1)
)


def there_and_back(points: np.ndarray) -> tuple[int, np.ndarray]:
    width, raw = encode_lattice(points, points.astype(np.int64).min(axis=0))
    return width, decode_lattice(raw, len(points), width)


@given(NEAR)
def test_ordered_points_within_21_bits_take_steps(points: np.ndarray) -> None:
    points = points[morton_order(points)]
    width, decoded = there_and_back(points)
    assert 1 <= width <= 8
    assert (decoded == points).all()


@given(POINTS)
def test_any_points_come_back(points: np.ndarray) -> None:
    assert (there_and_back(points)[1] == points).all()


@given(NEAR, st.integers(1, 8))
def test_a_part_of_the_curve_takes_steps_whatever_the_origin(points: np.ndarray, at: int) -> None:
    points = points[morton_order(points)]
    base = points.astype(np.int64).min(axis=0)
    for part in (points[:at], points[at:]):
        width, raw = encode_lattice(part, base)
        assert width or not len(part)
        assert (decode_lattice(raw, len(part), width) == part).all()


@pytest.mark.parametrize("low", [-(2**31), 2**31 - 2**21, -(2**20)])
def test_steps_reach_both_ends_of_int32(low: int) -> None:
    points = np.array([[low] * 3, [low + 2**21 - 1] * 3], np.int64).astype(np.int32)
    width, decoded = there_and_back(points)
    assert width == 8
    assert (decoded == points).all()


def test_wide_or_unordered_points_stand_as_they_are() -> None:
    for rows in ([[0, 0, 0], [2**21, 0, 0]], [[1, 0, 0], [0, 0, 0]]):
        width, decoded = there_and_back(np.array(rows, np.int32))
        assert width == 0
        assert (decoded == rows).all()


def raw_of(origin: tuple[int, int, int], first: int, steps: list[int]) -> bytes:
    planes = np.array(steps, "<u8").view(np.uint8).reshape(len(steps), 8).T.tobytes()
    return np.array(origin, "<i4").tobytes() + np.array([first], "<u8").tobytes() + planes


@pytest.mark.parametrize(
    ("origin", "first", "steps", "found"),
    [
        ((0, 0, 0), 1 << 63, [0, 0], "Morton code"),
        ((0, 0, 0), 2**63 - 1, [0, 2**64 - 5], "Morton code"),
        ((0, 0, 0), 2**64 - 1, [2, 0], "Morton code"),
        ((0, 0, 0), 2**63 - 1, [0, 2], "Morton code"),
        ((2**31 - 1, 0, 0), 0, [0, 1], "coordinate"),
    ],
)
def test_codes_that_no_writer_makes_are_refused(
    origin: tuple[int, int, int], first: int, steps: list[int], found: str
) -> None:
    with pytest.raises(CodecError, match=found):
        decode_lattice(raw_of(origin, first, steps), 2, 8)


@pytest.mark.parametrize("scales", [CodingId.FLOAT, CodingId.AFFINE8])
@pytest.mark.parametrize(("fresh", "width"), [(0, 0), (0, 2), (5, 0), (5, 1), (5, 3)])
def test_sections_make_up_their_columns(scales: CodingId, fresh: int, width: int) -> None:
    codings = (scales, CodingId.CURVE8, CodingId.CURVE8)
    shape = BlockShape(fresh, 70, 33, width, 4, 1, False, codings)
    columns, sections = column_bytes(shape), column_sections(shape)
    assert {column: sum(lengths) for column, lengths in sections.items()} == columns
    assert min(min(lengths) for lengths in sections.values()) >= 0
    assert len(sections[Column.LOG_SCALES]) == (2 if fresh else 1)
    assert len(sections[Column.LATTICE]) == (2 if fresh and width > 1 else 1)
