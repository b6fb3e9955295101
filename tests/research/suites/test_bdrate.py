"""Bjøntegaard delta rate against known pairs and the laws that it has."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from research.suites.bdrate import BdRate, bd_psnr, bd_rate, frontier, is_wide, pooled_spread

ONE = [(9487.76, 40.037), (4593.60, 38.615), (2486.44, 36.845), (1358.24, 34.851)]
TWO = [(9787.80, 40.121), (4469.00, 38.651), (2451.52, 36.970), (1356.24, 34.987)]
"""Two video codecs, from the documentation of the package bjontegaard (BSD)."""
KNOWN = -4.417485350589045
"""What its version 1.3.0 finds by `method="pchip"`."""
curves = st.lists(st.integers(200, 400), min_size=3, max_size=6, unique=True).flatmap(
    lambda qualities: st.lists(
        st.integers(1000, 10**7),
        min_size=len(qualities),
        max_size=len(qualities),
        unique=True,
    ).map(
        lambda sizes: [
            (float(a), b / 10) for a, b in zip(sorted(sizes), sorted(qualities), strict=True)
        ]
    )
)


def test_a_known_pair_gives_the_known_figure_and_range() -> None:
    found = bd_rate(ONE, TWO)
    assert found is not None
    assert found.percent == pytest.approx(KNOWN, abs=1e-9)
    assert (found.low, found.high) == (34.987, 40.037)


@given(curves, st.floats(0.1, 10))
def test_a_curve_is_itself_and_scaled_bytes_are_that_share(
    curve: list[tuple[float, float]], share: float
) -> None:
    same, scaled = bd_rate(curve, curve), bd_rate(curve, [(share * a, b) for a, b in curve])
    assert same is not None and scaled is not None
    assert same.percent == pytest.approx(0, abs=1e-9)
    assert scaled.percent == pytest.approx(100 * (share - 1), abs=1e-6)


@given(curves, curves)
def test_there_and_back_is_nothing(
    one: list[tuple[float, float]], two: list[tuple[float, float]]
) -> None:
    there, back = bd_rate(one, two), bd_rate(two, one)
    assert (there is None) == (back is None)
    if there and back:
        assert (1 + there.percent / 100) * (1 + back.percent / 100) == pytest.approx(1)
        assert (there.low, there.high) == (back.low, back.high)


def test_curves_without_a_common_quality_or_a_second_point_have_none() -> None:
    above = [(a, b + 10) for a, b in ONE]
    assert bd_rate(ONE, above) is None
    assert bd_rate(ONE, ONE[:1]) is None
    assert bd_rate([], ONE) is None


def test_points_that_another_beats_do_not_count() -> None:
    beaten = [*ONE, (5000.0, 38.0), (9487.76, 39.0)]
    assert frontier(beaten).tolist() == frontier(ONE).tolist()
    assert bd_rate(beaten, TWO) == bd_rate(ONE, TWO)


def test_decibels_at_equal_bytes_are_those_of_a_shifted_curve() -> None:
    above = [(a, b + 0.7) for a, b in ONE]
    assert bd_psnr(ONE, above) == pytest.approx(0.7, abs=1e-9)
    assert bd_psnr(ONE, ONE[:1]) is None
    assert bd_psnr(ONE, [(100 * a, b) for a, b in ONE]) is None


def test_a_range_is_wide_from_a_decibel_and_three_spreads_on() -> None:
    rates = [BdRate(-10.0, 18.0, 19.5), BdRate(-12.0, 18.4, 19.8)]
    assert is_wide(rates, 0) and is_wide(rates, 0.36) and not is_wide(rates, 0.37)
    assert not is_wide([BdRate(-10.0, 18.0, 18.9)], 0) and not is_wide([], 0)


def test_a_pooled_spread_is_that_within_groups() -> None:
    assert pooled_spread([[1.0], [5.0]]) == 0 and pooled_spread([]) == 0
    groups = [[1.0, 3.0], [10.0, 12.0, 17.0], [4.0]]
    slow = [(value - np.mean(group)) ** 2 for group in groups for value in group]
    assert pooled_spread(groups) == pytest.approx((sum(slow) / 3) ** 0.5)
