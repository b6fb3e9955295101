"""PSNR and SSIM against closed forms and a brute-force twin."""

import math

import numpy as np
import pytest
import torch

from gsynopsis.errors import DivergedError
from gsynopsis.evaluation.metrics import (
    C1,
    C2,
    PSNR_CAP,
    SIGMA,
    WINDOW,
    flip,
    psnr,
    ssim,
    ssim_map,
    to_bytes,
)
from tests.devices import DEVICES


def flat(value: int, size: tuple[int, int] = (31, 29)) -> np.ndarray:
    return np.full((*size, 3), value, np.uint8)


@pytest.mark.parametrize("offset", [1, 7, 100])
def test_psnr_of_a_constant_offset_is_the_closed_form(offset: int) -> None:
    assert psnr(flat(120), flat(120 + offset)) == pytest.approx(20 * math.log10(255 / offset))


def test_psnr_does_not_wrap_around_as_bytes_would() -> None:
    assert psnr(flat(0), flat(255)) == pytest.approx(0.0, abs=1e-12)
    assert psnr(flat(255), flat(0)) == pytest.approx(0.0, abs=1e-12)


def test_psnr_counts_all_channels_and_pixels_alike() -> None:
    image = flat(100)
    image[3, 4, 1] += 50
    expected = -10 * math.log10((50 / 255) ** 2 / image.size)
    assert psnr(image, flat(100)) == pytest.approx(expected)


def test_identical_images_get_the_cap_and_ssim_one() -> None:
    image = np.random.default_rng(0).integers(0, 256, (20, 24, 3), np.uint8)
    assert psnr(image, image) == PSNR_CAP
    assert ssim(image, image) == pytest.approx(1.0, abs=1e-12)


def test_ssim_of_a_constant_offset_is_the_luminance_term_inside_the_border() -> None:
    a, b = 100 / 255, 140 / 255
    expected = (2 * a * b + C1) / (a * a + b * b + C1)
    inside = ssim_map(flat(100), flat(140))[:, 5:-5, 5:-5]
    assert torch.allclose(inside, torch.full_like(inside, expected), atol=1e-12)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("size", [(13, 9), (4, 17), (1, 1)])
def test_ssim_equals_a_brute_force_twin_in_plain_loops(size: tuple[int, int], device: str) -> None:
    rng = np.random.default_rng(3)
    truth = rng.integers(0, 256, (*size, 3), np.uint8)
    image = np.clip(truth + rng.integers(-40, 41, truth.shape), 0, 255).astype(np.uint8)
    image.flags.writeable = truth.flags.writeable = False  # as photos are
    found = ssim(image, truth, torch.device(device))
    assert found == pytest.approx(brute_ssim(image, truth), abs=1e-12)


def brute_ssim(image: np.ndarray, truth: np.ndarray) -> float:
    """The definition: a full 2-D window at every pixel, zeros outside the image."""
    half = WINDOW // 2
    weights = np.exp(-(np.arange(-half, half + 1) ** 2) / (2 * SIGMA**2))
    window = np.outer(weights, weights) / weights.sum() ** 2
    values: list[float] = []
    for channel in range(3):
        x = np.pad(image[..., channel] / 255.0, half)
        y = np.pad(truth[..., channel] / 255.0, half)
        for row in range(image.shape[0]):
            for column in range(image.shape[1]):
                place = np.s_[row : row + WINDOW, column : column + WINDOW]
                values.append(_one_window(x[place], y[place], window))
    return float(np.mean(values))


def _one_window(x: np.ndarray, y: np.ndarray, window: np.ndarray) -> float:
    mx, my = (window * x).sum(), (window * y).sum()
    vx, vy = (window * x * x).sum() - mx**2, (window * y * y).sum() - my**2
    cov = (window * x * y).sum() - mx * my
    return ((2 * mx * my + C1) * (2 * cov + C2)) / ((mx**2 + my**2 + C1) * (vx + vy + C2))


def test_ssim_falls_with_noise_while_psnr_of_flat_shift_stays_blind_to_structure() -> None:
    rng = np.random.default_rng(5)
    truth = rng.integers(60, 196, (32, 32, 3), np.uint8)
    shifted = (truth + 20).astype(np.uint8)
    signs = rng.choice([-20, 20], truth.shape)
    noisy = (truth.astype(int) + signs).astype(np.uint8)
    assert psnr(shifted, truth) == pytest.approx(psnr(noisy, truth))
    assert ssim(noisy, truth) < ssim(shifted, truth)


def test_renderings_are_clamped_and_rounded_as_a_png_would() -> None:
    image = torch.tensor([[[-0.5, 1.7, 100.4 / 255], [100.6 / 255, 0.0, 1.0]]])
    assert to_bytes(image).tolist() == [[[0, 255, 100], [101, 0, 255]]]


def test_a_rendering_that_is_not_finite_is_refused() -> None:
    image = torch.zeros(2, 2, 3)
    image[1, 0, 2] = math.nan
    with pytest.raises(DivergedError, match="not finite"):
        to_bytes(image)


def test_images_of_different_sizes_cannot_be_compared() -> None:
    with pytest.raises(ValueError, match="cannot be compared"):
        psnr(flat(0), flat(0, (31, 30)))
    with pytest.raises(ValueError, match="cannot be compared"):
        ssim(flat(0), flat(0, (30, 29)))


def test_flip_is_nothing_for_one_image_and_grows_with_what_is_seen() -> None:
    pytest.importorskip("flip_evaluator")
    truth = np.random.default_rng(0).integers(0, 256, (24, 32, 3)).astype(np.uint8)
    near, far = truth // 2 + 60, np.zeros_like(truth)
    assert flip(truth, truth) == 0
    assert 0 < flip(near.astype(np.uint8), truth) < flip(far, truth) <= 1
    black, white = np.zeros_like(truth), np.full_like(truth, 255)
    assert flip(white, black) == pytest.approx(0.967, abs=0.01)
