"""Cubic resampling by the kernel is that of the formula."""

import numpy as np
import pytest
from numpy.typing import NDArray

from gsynopsis._native import _core
from gsynopsis.scene.resample import ROWS, resample

Float64 = NDArray[np.float64]


def keys(distance: Float64) -> Float64:
    """Keys' kernel with a = -1/2 (IEEE TASSP 29, 1981, eq. 15)."""
    s = np.abs(distance)
    inner = 1.5 * s**3 - 2.5 * s**2 + 1
    outer = -0.5 * s**3 + 2.5 * s**2 - 4 * s + 2
    return np.where(s < 1, inner, np.where(s < 2, outer, 0.0))


def sampled(pixels: NDArray[np.uint8], places: Float64) -> Float64:
    """The plain twin: sums over all pixels, those at the edge repeated outside of it."""
    across = np.arange(-8, pixels.shape[1] + 8)
    down = np.arange(-8, pixels.shape[0] + 8)
    wide = pixels[np.ix_(down.clip(0, len(pixels) - 1), across.clip(0, pixels.shape[1] - 1))]
    x = keys(places[:, :1] - 0.5 - across)
    y = keys(places[:, 1:] - 0.5 - down)
    return np.einsum("nj,jic,ni->nc", y, wide.astype(np.float64), x)


@pytest.mark.parametrize("size", [(40, 30), (3, 2), (1, 1)])
def test_the_kernel_is_the_formula_within_a_rounding(size: tuple[int, int], rng) -> None:
    pixels = rng.integers(0, 256, (size[1], size[0], 3)).astype(np.uint8)
    places = rng.uniform(-1.4, np.array(size) + 1.4, (500, 2)).astype(np.float32)
    places[:4] = [[0.5, 0.5], size, [0, 0], np.array(size) - 0.5]
    found = np.empty((500, 3), np.uint8)
    _core.sample_cubic(pixels, places, found)
    exact = sampled(pixels, places.astype(np.float64)).clip(0, 255)
    assert np.abs(found - exact).max() < 0.501
    assert found[0].tolist() == pixels[0, 0].tolist()
    assert found[3].tolist() == pixels[-1, -1].tolist()


def test_places_far_outside_and_none_at_all_are_the_edge(rng) -> None:
    pixels = rng.integers(0, 256, (5, 7, 3)).astype(np.uint8)
    far = np.array([[-1e30, -1e30], [1e30, 1e30], [np.nan, np.nan], [np.inf, -np.inf]], np.float32)
    found = np.empty((4, 3), np.uint8)
    _core.sample_cubic(pixels, far, found)
    first, last = pixels[0, 0].tolist(), pixels[-1, -1].tolist()
    assert found.tolist() == [first, last, first, pixels[0, -1].tolist()]


def test_an_image_of_several_strips_is_the_photo_where_nothing_moves(rng) -> None:
    pixels = rng.integers(0, 256, (2 * ROWS + 5, 9, 3)).astype(np.uint8)
    assert np.array_equal(resample(pixels, (9, 2 * ROWS + 5), lambda places: places), pixels)
    turned = resample(pixels[::-1], (9, 2 * ROWS + 5), lambda places: places)
    assert np.array_equal(turned, pixels[::-1]), "not contiguous"


@pytest.mark.parametrize(
    ("pixels", "places", "colors"),
    [
        (np.zeros((0, 4, 3), np.uint8), np.zeros((1, 2), np.float32), np.zeros((1, 3), np.uint8)),
        (np.zeros((4, 4, 3), np.uint8), np.zeros((2, 2), np.float32), np.zeros((1, 3), np.uint8)),
        (np.zeros((4, 4), np.uint8), np.zeros((1, 2), np.float32), np.zeros((1, 3), np.uint8)),
    ],
)
def test_arrays_that_do_not_fit_are_refused(pixels, places, colors) -> None:
    with pytest.raises(ValueError, match=r"pixels|places|colors"):
        _core.sample_cubic(pixels, places, colors)
