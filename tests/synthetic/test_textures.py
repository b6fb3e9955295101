"""Patterns: their range, and that a wide pixel sees their mean."""

import numpy as np
import pytest

from gsynopsis.synthetic.raytracer import Spot, decode_srgb
from gsynopsis.synthetic.textures import (
    FLAT,
    cells,
    checker,
    facing,
    mix,
    mottled,
    over,
    placed,
    plain,
    rectangle,
    stripes,
    waves,
)

WHITE, BLACK = plain("#ffffff"), plain("#000000")


def spots(rng, count=5000, footprint=1e-4, reach=3.0) -> Spot:
    position = rng.uniform(-reach, reach, (3, count)).astype(np.float32)
    normal = np.repeat(np.array([[0], [0], [1]], np.float32), count, axis=1)
    return Spot(position, normal, np.full(count, footprint, np.float32))


def test_noise_has_mean_zero_and_lies_mostly_within_one(rng):
    value = waves(5, 1.0, 0.1)(spots(rng))
    assert abs(value.mean()) < 0.06 and value.std() == pytest.approx(0.5, abs=0.1)
    assert (np.abs(value) < 1).mean() > 0.9


def test_noise_is_no_finer_than_its_shortest_wave(rng):
    # The slope of a cosine of wavelength λ and amplitude a is at most 2πa/λ; 48 of them add up.
    field, here = waves(6, 0.8, 0.2), spots(rng)
    step = np.float32(1e-3)
    there = Spot(here.position + step * np.array([[1], [0], [0]]), here.normal, here.footprint)
    slope = np.abs(field(there) - field(here)) / step
    assert slope.max() < 2 * np.pi / 0.2 * 2


def test_noise_of_one_seed_is_the_same_and_of_another_is_not(rng):
    here = spots(rng)
    np.testing.assert_array_equal(waves(1, 1, 0.1)(here), waves(1, 1, 0.1)(here))
    assert np.abs(waves(1, 1, 0.1)(here) - waves(2, 1, 0.1)(here)).max() > 0.5


@pytest.mark.parametrize(
    "paint",
    [
        stripes(WHITE, BLACK, (1, 0, 0), 0.2),
        checker(WHITE, BLACK, 0.1),
        mottled(("#000000", "#ffffff"), waves(3, 0.3, 0.1)),
    ],
)
def test_a_pixel_wider_than_a_pattern_sees_its_mean(rng, paint):
    fine, wide = paint(spots(rng)), paint(spots(rng, footprint=1.0))
    assert fine.std() > 0.15
    np.testing.assert_allclose(wide, 0.5, atol=0.02)
    assert fine.min() >= 0 and fine.max() <= 1


def test_cells_have_the_given_colours_and_dark_gaps(rng):
    paint = cells(3, ("#404040",), (0.5, 0.25), FLAT, 0.02)
    value = paint(spots(rng)) / decode_srgb("#404040")
    assert value.max() < 1.16 and np.quantile(value, 0.9) > 0.75 and value.min() < 0.5


def test_a_rectangle_covers_what_it_says(rng):
    here = spots(rng)
    value = over(BLACK, WHITE, rectangle((0, 1), (0.5, -0.5), (1.0, 0.7)))(here)
    inside = (np.abs(here.position[0] - 0.5) < 1) & (np.abs(here.position[1] + 0.5) < 0.7)
    assert (value[0] > 0.5).tolist() == inside.tolist()


def test_a_placed_paint_moves_and_turns_with_its_object():
    split = over(BLACK, WHITE, rectangle((0, 1), (5, 0), (5, 9)))
    moved = placed(split, (2, 0, 0), np.pi / 2)
    # White where the object's own x > 0: turned by a quarter, that is y > 0.
    position = np.array([[2, 2, 9], [1, -1, 1], [0, 0, 0]], np.float32)
    spot = Spot(position, np.zeros_like(position), np.full(3, 1e-3, np.float32))
    assert moved(spot)[0].tolist() == [1, 0, 1]


def test_a_paint_over_another_is_their_mix_wherever_it_is_asked(rng):
    base, top = mottled(("#102030", "#c0b0a0"), waves(1, 1, 0.1)), checker(WHITE, BLACK, 0.3)
    here, inside = spots(rng, footprint=0.2), rectangle((0, 1), (0.5, -0.5), (1.0, 0.7))
    share = np.clip(inside(here) / here.footprint + 0.5, 0, 1)
    assert 0 < (share == 0).mean() < 1 and ((share > 0) & (share < 1)).any()
    expected = mix(base(here), top(here), share)
    np.testing.assert_array_equal(over(base, top, inside)(here), expected)


def test_a_side_has_its_paint_where_the_surface_looks_along_its_axis(rng):
    here = spots(rng)
    here.normal[:, ::3] = [[0], [1], [0]]
    base, side = mottled(("#102030", "#c0b0a0"), waves(1, 1, 0.1)), checker(WHITE, BLACK, 0.3)
    expected = np.where(here.normal[1] > 0.9, side(here), base(here))
    np.testing.assert_array_equal(facing(base, side, 1)(here), expected)
