"""PSNR of parts of an image."""

import numpy as np
import pytest

from gsynopsis.evaluation.masked_psnr import psnr_exposed, psnr_inside
from gsynopsis.evaluation.metrics import PSNR_CAP, psnr


def test_inside_everything_is_the_plain_figure_and_inside_nothing_is_none(rng) -> None:
    image, truth = rng.integers(0, 256, (2, 9, 8, 3)).astype(np.uint8)
    assert psnr_inside(image, truth, np.ones((9, 8), bool)) == pytest.approx(psnr(image, truth))
    assert psnr_inside(image, truth, np.zeros((9, 8), bool)) is None


def test_what_is_outside_does_not_count(rng) -> None:
    image = rng.integers(0, 256, (9, 8, 3)).astype(np.uint8)
    truth, inside = image.copy(), np.zeros((9, 8), bool)
    truth[:, 4:], inside[:, :4] = 0, True
    assert psnr_inside(image, truth, inside) == PSNR_CAP


def test_an_affine_colour_is_taken_out_and_noise_is_not(rng) -> None:
    image = rng.integers(20, 200, (40, 40, 3)).astype(np.uint8)
    truth = np.rint(image * [1.1, 0.9, 1.0] + [3, 0, -5]).clip(0, 255).astype(np.uint8)
    exposed = psnr_exposed(image, truth)
    assert exposed is not None and exposed > 50 > psnr(image, truth)
    noise = rng.integers(0, 256, (40, 40, 3)).astype(np.uint8)
    other = psnr_exposed(image, noise)
    assert other is not None and other < 15
