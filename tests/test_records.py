from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gsynopsis.records import (
    HEAD_NAMES,
    MORTON_BITS,
    LevelSet,
    PlainGaussians,
    input_width,
    morton_codes,
    morton_order,
    network_shapes,
    positions,
)
from tests.level_sets import ALL_SHAPES, BOTH, FREE, FUSED, assert_same, make_level_set

POINTS = hnp.arrays(np.int32, st.tuples(st.integers(0, 30), st.just(3)))
NEAR = hnp.arrays(np.int32, st.tuples(st.integers(0, 30), st.just(3)), elements=st.integers(-9, 9))


def slow_code(point: list[int]) -> int:
    """Bits of x, y, z interleaved one by one, x lowest."""
    return sum((point[a] >> bit & 1) << (3 * bit + a) for bit in range(32) for a in range(3))


@given(hnp.arrays(np.uint64, (5, 3), elements=st.integers(0, 2**MORTON_BITS - 1)))
def test_morton_codes_interleave_bits(points: np.ndarray) -> None:
    assert morton_codes(points).tolist() == [slow_code(p) for p in points.tolist()]


@given(NEAR)
def test_morton_order_sorts_by_codes_from_the_smallest_corner(points: np.ndarray) -> None:
    order = morton_order(points)
    assert order.dtype == np.int64
    assert sorted(order.tolist()) == list(range(len(points)))
    if len(points):
        codes = [slow_code(p) for p in (points - points.min(axis=0))[order].tolist()]
        assert codes == sorted(codes)


@given(POINTS, st.randoms(use_true_random=False))
def test_morton_order_is_total_whatever_the_range_and_order(points: np.ndarray, random) -> None:
    shuffled = list(range(len(points)))
    random.shuffle(shuffled)
    again = points[shuffled]
    assert (points[morton_order(points)] == again[morton_order(again)]).all()


def test_morton_order_keeps_neighbours_of_a_wide_lattice_together() -> None:
    near = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1]], np.int64)
    wide = np.concatenate([near + 2**31 - 2, near - 2**31]).astype(np.int32)
    assert morton_order(wide).tolist() == [3, 4, 5, 0, 1, 2]


def test_morton_order_is_stable_for_equal_points_and_takes_none() -> None:
    assert morton_order(np.zeros((4, 3), np.int32)).tolist() == [0, 1, 2, 3]
    assert morton_order(np.zeros((0, 3), np.int32)).tolist() == []


def test_positions_are_rounded_once_from_float64() -> None:
    levels = make_level_set(np.random.default_rng(0))
    expected = [
        [np.float32(float(k) * levels.frame.voxel) for k in row]
        for row in levels.shared.lattice.tolist()
    ]
    assert (positions(levels.frame, levels.shared.lattice) == np.array(expected)).all()


@pytest.mark.parametrize("name", ALL_SHAPES)
def test_upto_keeps_a_prefix_and_blanks_dead_slots(name: str) -> None:
    levels = make_level_set(np.random.default_rng(0), ALL_SHAPES[name])
    for k, level in enumerate(levels.levels):
        part = levels.upto(k)
        assert len(part.levels) == k + 1
        assert len(part.shared.lattice) == level.anchors
        assert len(part.shared.grids) == level.grids
        mask = level.mask
        assert (part.shared.offsets[mask] == levels.shared.offsets[: level.anchors][mask]).all()
        assert not part.shared.offsets[~mask].any()
        assert_same(part.upto(k), part)
    assert_same(levels.upto(len(levels.levels) - 1).upto(0), levels.upto(0))


@pytest.mark.parametrize("shape", [BOTH, FREE, FUSED])
def test_networks_fit_the_features_they_read(shape) -> None:
    levels = make_level_set(np.random.default_rng(0), shape)
    for level in levels.levels:
        width = input_width(levels.shared, level)
        assert width == level.grids * shape.features + shape.code_width + shape.residual
        shapes = network_shapes(width, shape.slots, shape.hidden, shape.fuse)
        inner = shape.fuse[1] if shape.fuse else width
        assert shapes["color_w1"] == (shape.hidden, inner + 4)
        assert [shapes[f"{h}_b2"][0] for h in HEAD_NAMES] == [k * shape.slots for k in (1, 7, 3)]


def shared(**fields: object) -> Callable[[LevelSet], LevelSet]:
    return lambda s: replace(s, shared=replace(s.shared, **fields))


def level(number: int, **fields: object) -> Callable[[LevelSet], LevelSet]:
    def change(s: LevelSet) -> LevelSet:
        levels = list(s.levels)
        levels[number] = replace(levels[number], **fields)
        return replace(s, levels=tuple(levels))

    return change


def frame(**fields: object) -> Callable[[LevelSet], LevelSet]:
    return lambda s: replace(s, frame=replace(s.frame, **fields))


def some_off(s: LevelSet) -> LevelSet:
    mask = s.levels[2].mask.copy()
    mask[0] = ~s.levels[1].mask[0]
    return level(2, mask=mask)(s)


def none_on(s: LevelSet) -> LevelSet:
    mask = s.levels[3].mask.copy()
    mask[-1] = False
    return level(3, mask=mask)(s)


BROKEN: dict[str, tuple[Callable[[LevelSet], LevelSet], str]] = {
    "voxel": (frame(voxel=0.0), "frame"),
    "center": (frame(center=np.array([0, np.nan, 0])), "frame"),
    "radius": (frame(radius=-1.0), "frame"),
    "extent": (frame(extent=np.inf), "frame"),
    "lattice type": (shared(lattice=np.zeros((40, 3), np.int64)), "lattice: found int64"),
    "log_scales": (shared(log_scales=np.zeros((40, 5), np.float32)), "log_scales: found"),
    "offsets": (shared(offsets=np.zeros((39, 4, 3), np.float32)), "offsets: found"),
    "codes": (shared(codes=np.zeros(39, np.uint8)), "codes: found"),
    "no codes": (shared(codes=np.zeros(0, np.uint8)), "codes and codebook"),
    "code": (shared(codes=np.full(40, 5, np.uint8)), "a code is out"),
    "residual": (shared(residual=np.zeros((1, 3), np.float32)), "residual: found"),
    "resolutions": (shared(grid_resolutions=(1,)), "one resolution for each"),
    "grid": (shared(grids=[np.zeros((2, 2)) for _ in range(3)]), "grid 0: found float64"),
    "no level": (lambda s: replace(s, levels=()), "at least one level"),
    "mask type": (level(0, mask=np.ones((4, 4), np.uint8)), "level 0 mask: found uint8"),
    "mask rows": (level(3, mask=np.ones((41, 4), np.bool_)), "more than the 40"),
    "no slot": (none_on, "without a live slot"),
    "not nested": (some_off, "level 1 is not contained in level 2"),
    "grids": (level(3, grids=4), "reads 4 of 3 grids"),
    "fewer grids": (lambda s: more_grids(s), "level 0 reads more grids than level 1"),
    "codebook": (level(1, codebook=np.zeros((5, 3))), "codebook: found float64"),
    "gain": (level(1, gain=np.ones(2, np.float32)), "gain: found"),
    "names": (
        lambda s: level(1, networks=dict([*s.levels[1].networks.items()][::-1]))(s),
        "networks",
    ),
    "weights": (lambda s: narrow(s), "level 0 cov_b1: found"),
    "finest": (lambda s: replace(s, levels=s.levels[:3]), "does not hold all anchors"),
}


def more_grids(s: LevelSet) -> LevelSet:
    source = s.levels[2]
    return level(0, grids=source.grids, networks=source.networks)(s)


def narrow(s: LevelSet) -> LevelSet:
    networks = {**s.levels[0].networks, "cov_b1": np.zeros(3, np.float32)}
    return level(0, networks=networks)(s)


@pytest.mark.parametrize("name", BROKEN)
def test_what_does_not_fit_together_is_refused(name: str) -> None:
    change, message = BROKEN[name]
    with pytest.raises(ValueError, match=message):
        change(make_level_set(np.random.default_rng(0)))


@pytest.mark.parametrize("coefficients", [0, 1, 3, 4, 9, 16])
def test_plain_gaussians_take_the_four_degrees_of_harmonics(coefficients: int) -> None:
    def make() -> PlainGaussians:
        ones = [np.ones((5, n), np.float32) for n in (3, 3, 4)]
        return PlainGaussians(*ones, np.zeros(5, np.float32), np.zeros((5, coefficients, 3), "f4"))

    if coefficients in (1, 4, 9, 16):
        assert (len(make()), (make().degree + 1) ** 2) == (5, coefficients)
    else:
        with pytest.raises(ValueError, match="sh"):
            make()


def test_plain_gaussians_of_other_shapes_are_refused() -> None:
    row = np.ones((2, 3), np.float32)
    with pytest.raises(ValueError, match="quaternions"):
        PlainGaussians(row, row, row, np.zeros(2, np.float32), np.zeros((2, 1, 3), np.float32))
