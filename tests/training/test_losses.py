"""Losses against plain formulas."""

import math
from functools import partial

import numpy as np
import pytest
import torch

from gsynopsis._native import _core
from gsynopsis.training.losses import (
    mean_squared_reference,
    sparsity_loss,
    ssim,
    ssim_window,
    unit_pixels_reference,
    volume_reference,
)
from gsynopsis.training.view_step import (
    mean_squared_error,
    photometric_loss,
    unit_pixels,
    volume_loss,
)


def brute_ssim(a: np.ndarray, b: np.ndarray) -> float:
    """SSIM pixel by pixel with an explicit zero-padded window."""
    window = ssim_window(torch.float64, torch.device("cpu")).numpy()
    weights = np.outer(window, window)[:, :, None]
    pad = ((5, 5), (5, 5), (0, 0))
    a, b = np.pad(a, pad), np.pad(b, pad)
    total = []
    for y in range(a.shape[0] - 10):
        for x in range(a.shape[1] - 10):
            p, q = a[y : y + 11, x : x + 11], b[y : y + 11, x : x + 11]
            mp, mq = (weights * p).sum((0, 1)), (weights * q).sum((0, 1))
            vp = (weights * p * p).sum((0, 1)) - mp**2
            vq = (weights * q * q).sum((0, 1)) - mq**2
            cov = (weights * p * q).sum((0, 1)) - mp * mq
            top = (2 * mp * mq + 1e-4) * (2 * cov + 9e-4)
            total.append(top / ((mp**2 + mq**2 + 1e-4) * (vp + vq + 9e-4)))
    return float(np.mean(total))


def test_ssim_equals_the_explicit_window(rng: np.random.Generator) -> None:
    a, b = rng.random((9, 13, 3)), rng.random((9, 13, 3))
    found = float(ssim(torch.from_numpy(a), torch.from_numpy(b)))
    assert math.isclose(found, brute_ssim(a, b), abs_tol=1e-12)


def test_photometric_loss_of_equal_images_is_zero_and_its_gradient_correct() -> None:
    generator = torch.Generator().manual_seed(0)
    a = torch.rand(7, 6, 3, generator=generator, dtype=torch.float64)
    b = torch.rand(7, 6, 3, generator=generator, dtype=torch.float64)
    assert float(photometric_loss(a, a, 0.2)) < 1e-12
    a.requires_grad_(True)
    assert torch.autograd.gradcheck(lambda x: photometric_loss(x, b, 0.2), (a,), atol=1e-6)


def test_volume_is_the_mean_product_and_zero_for_nothing() -> None:
    scales = torch.tensor([[1.0, 2.0, 3.0], [1.0, 1.0, 2.0]])
    assert float(volume_loss(scales)) == 4.0
    assert float(volume_loss(torch.zeros(0, 3))) == 0.0


def test_the_native_volume_equals_its_twin() -> None:
    g = torch.Generator().manual_seed(0)
    scales = torch.rand(1001, 3, generator=g, dtype=torch.float64)
    fast, slow = scales.float().requires_grad_(True), scales.clone().requires_grad_(True)
    found, expected = volume_loss(fast), volume_reference(slow)
    (3 * found).backward()
    (3 * expected).backward()
    assert fast.grad is not None and slow.grad is not None
    assert float(found.detach()) == pytest.approx(float(expected.detach()), rel=1e-6)
    assert torch.allclose(fast.grad.double(), slow.grad, rtol=1e-5, atol=1e-9)


def test_sparsity_terms_are_means_in_zero_to_one() -> None:
    logits, live = torch.full((4, 9), 50.0), torch.ones(4, 9, dtype=torch.bool)
    assert math.isclose(float(sparsity_loss(logits, live, 1.0)), 2.0, rel_tol=1e-6)
    assert float(sparsity_loss(-logits, live, 1.0)) < 1e-5
    one = torch.zeros(4, 9, dtype=torch.bool)
    one[:, 0] = True
    # One live slot of nine per anchor: mean 1, group norm 1/√9.
    assert math.isclose(float(sparsity_loss(logits, one, 3.0)), 2.0, rel_tol=1e-5)


def loss_and_gradient(
    image: torch.Tensor, target: torch.Tensor, weight: float
) -> tuple[float, torch.Tensor]:
    leaf = image.clone().requires_grad_(True)
    loss = photometric_loss(leaf, target, weight)
    loss.backward()
    assert leaf.grad is not None
    return float(loss.detach()), leaf.grad


@pytest.mark.parametrize("variant", _core.variants())
@pytest.mark.parametrize(
    # The last ones are of several patches.
    "size",
    [(1, 1), (5, 3), (17, 1), (2, 40), (33, 47), (9, 161), (129, 12), (129, 161)],
)
def test_the_native_loss_equals_its_twin(
    variant: str, size: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    native = partial(_core.photometric, variant=variant)
    monkeypatch.setattr(_core, "photometric", native)
    generator = torch.Generator().manual_seed(sum(size))
    image = torch.rand(*size, 3, generator=generator, dtype=torch.float64) * 1.2 - 0.1
    target = torch.rand(*size, 3, generator=generator, dtype=torch.float64)
    for weight in (0.0, 0.2, 1.0):
        value, gradient = loss_and_gradient(image, target, weight)
        found, slope = loss_and_gradient(image.float(), target.float(), weight)
        assert math.isclose(found, value, rel_tol=2e-5, abs_tol=2e-6)
        assert (slope.double() - gradient).abs().max() <= 2e-4 * gradient.abs().max()


def test_the_native_gradient_is_given_to_one_backward_pass() -> None:
    image, target = torch.rand(2, 6, 7, 3).unbind()
    leaf = image.requires_grad_(True)
    loss = 0.25 * photometric_loss(leaf, target, 0.2)
    loss.backward(retain_graph=True)
    assert leaf.grad is not None
    found, whole = leaf.grad.clone(), loss_and_gradient(image.detach(), target, 0.2)[1]
    assert torch.equal(found, 0.25 * whole)
    with pytest.raises(RuntimeError, match="earlier backward pass"):
        loss.backward()


def test_the_native_loss_is_the_same_bits_for_any_number_of_threads() -> None:
    generator = torch.Generator().manual_seed(4)
    image, target = (torch.rand(301, 235, 3, generator=generator) for _ in range(2))
    before = torch.get_num_threads()
    try:
        results = []
        for threads in (1, 2):
            torch.set_num_threads(threads)
            results.append(loss_and_gradient(image, target, 0.2))
    finally:
        torch.set_num_threads(before)
    assert results[0][0] == results[1][0] and torch.equal(results[0][1], results[1][1])


@pytest.mark.parametrize("shape", [(1, 1, 3), (7, 5, 3), (120, 170, 3)])
def test_the_native_squared_error_equals_its_twin(shape: tuple[int, ...]) -> None:
    one, other = torch.rand(2, *shape).unbind()
    found = mean_squared_error(one.requires_grad_(), other)
    expected = mean_squared_reference(one.double(), other.double())
    assert found.dtype == torch.float64 and not found.requires_grad
    assert float(found) == pytest.approx(float(expected), rel=1e-7)
    alone = _core.mean_squared(one.detach().view(-1).numpy(), other.view(-1).numpy(), 1)
    assert alone == _core.mean_squared(one.detach().view(-1).numpy(), other.view(-1).numpy(), 3)


def test_pixels_are_divided_as_pytorch_does() -> None:
    every = torch.arange(256, dtype=torch.uint8).repeat(3 * 200).view(-1, 64, 3)
    read_only = every.numpy()
    read_only.flags.writeable = False
    for pixels in (every, read_only, every[:, ::2], read_only[::2]):
        assert torch.equal(unit_pixels(pixels), unit_pixels_reference(pixels))
