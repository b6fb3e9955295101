"""Grids and codebook against plain formulas."""

import numpy as np
import pytest
import torch
from torch import Tensor

from gsynopsis.model.encoding import (
    PRIMES,
    GridLayout,
    StraightThrough,
    coarsest_grids,
    grid_coordinates,
    grid_features,
    grid_features_indexed,
    grid_layout,
)
from gsynopsis.records import Frame
from tests.devices import DEVICES

LAYOUT = grid_layout((5, 9, 17, 33), 8)


def frame(contract: bool) -> Frame:
    return Frame(0.1, np.array([1.0, -2.0, 0.5]), 2.0, contract, 3.0)


def grid_corners(u: Tensor, resolution: int, size: int) -> tuple[Tensor, Tensor]:
    """Rows and trilinear weights of the 8 corners around each point.

    Args:
        u: [V, 3] in [0, 1].
        resolution: Vertices per axis.
        size: Rows of this grid; it is dense where resolution³ fits, else hashed.

    Returns:
        Row indices int64 [V, 8] and weights [V, 8] that sum to 1.
    """
    p = u * (resolution - 1)
    cell = p.floor().clamp(0, max(resolution - 2, 0))
    frac = p - cell
    corner = torch.tensor([[c & 1, (c >> 1) & 1, c >> 2] for c in range(8)], device=u.device)
    vertex = (cell.long()[:, None] + corner).clamp(max=resolution - 1)  # [V, 8, 3]
    if resolution**3 <= size:
        rows = vertex[..., 0] + vertex[..., 1] * resolution + vertex[..., 2] * resolution**2
    else:
        rows = vertex[..., 0] ^ (vertex[..., 1] * PRIMES[1]) ^ (vertex[..., 2] * PRIMES[2])
        rows = (rows & 0xFFFFFFFF) % size
    weights = torch.where(corner.bool(), frac[:, None], 1 - frac[:, None]).prod(dim=2)
    return rows, weights


def grid_features_reference(u: Tensor, table: Tensor, layout: GridLayout) -> Tensor:
    """Interpolated features [V, L·F], one grid after the other: the oracle."""
    parts = []
    for resolution, size, offset in zip(
        layout.resolutions, layout.sizes, layout.offsets, strict=True
    ):
        rows, weights = grid_corners(u, resolution, size)
        parts.append((table[rows + offset] * weights[..., None].to(table.dtype)).sum(dim=1))
    return torch.cat(parts, dim=1) if parts else u.new_zeros(len(u), 0)


def test_hashed_rows_are_those_of_python_integers() -> None:
    u = torch.rand(50, 3, generator=torch.Generator().manual_seed(1))
    rows, _ = grid_corners(u, 33, 256)
    for point, found in zip(u, rows, strict=True):
        cell = [min(int(np.floor(np.float32(x) * np.float32(32))), 31) for x in point]
        for corner in range(8):
            x, y, z = (cell[0] + (corner & 1), cell[1] + (corner >> 1 & 1), cell[2] + (corner >> 2))
            mixed = (x * PRIMES[0]) ^ (y * PRIMES[1]) ^ (z * PRIMES[2])
            assert int(found[corner]) == (mixed & 0xFFFFFFFF) % 256


def test_dense_rows_count_x_first() -> None:
    rows, weights = grid_corners(torch.tensor([[0.25, 0.5, 1.0]]), 5, 125)
    assert int(rows[0, 0]) == 1 + 2 * 5 + 3 * 25
    assert torch.allclose(weights.sum(dim=1), torch.ones(1))


def test_interpolation_of_a_linear_field_is_exact_on_a_dense_grid() -> None:
    layout = grid_layout((9,), 10)
    z, y, x = torch.meshgrid(*[torch.linspace(0, 1, 9)] * 3, indexing="ij")
    table = torch.zeros(layout.rows, 4)
    table[: 9**3] = torch.stack([x, y, z, x + 2 * y - z], dim=-1).reshape(-1, 4)
    u = torch.rand(40, 3, generator=torch.Generator().manual_seed(2))
    expected = torch.cat([u, (u @ torch.tensor([1.0, 2.0, -1.0]))[:, None]], dim=1)
    assert torch.allclose(grid_features_reference(u, table, layout), expected, atol=1e-6)


@pytest.mark.parametrize("count", [0, 1, 4])
def test_native_features_and_gradients_equal_the_plain_ones(count: int) -> None:
    generator = torch.Generator().manual_seed(3)
    layout = coarsest_grids(LAYOUT, count)
    u = torch.cat([torch.rand(300, 3, generator=generator), torch.eye(3), torch.ones(1, 3)])
    table = torch.randn(LAYOUT.rows, 4, generator=generator)
    weight = torch.randn(len(u), count * 4, generator=generator)
    results = []
    for function in (grid_features, grid_features_reference):
        leaf = table.clone().requires_grad_(True)
        out = function(u, leaf, layout)
        if count:
            (out * weight).sum().backward()
        results.append((out.detach(), leaf.grad if count else torch.zeros(1)))
    assert torch.allclose(results[0][0], results[1][0], atol=1e-5)
    assert torch.allclose(results[0][1], results[1][1], atol=1e-4)


def test_grid_gradient_equals_finite_differences() -> None:
    generator = torch.Generator().manual_seed(4)
    layout = grid_layout((5, 9), 6)
    u = torch.rand(6, 3, generator=generator, dtype=torch.float64)
    table = torch.randn(layout.rows, 4, generator=generator, dtype=torch.float64)
    table.requires_grad_(True)
    for function in (grid_features_reference, grid_features_indexed):
        assert torch.autograd.gradcheck(lambda t, f=function: f(u, t, layout), (table,))


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("resolutions", [(5, 9, 17, 33), (1, 2, 3), (9, 59, 511)])
def test_indexed_features_and_gradients_equal_the_plain_ones(
    resolutions: tuple[int, ...], dtype: torch.dtype, device: str
) -> None:
    generator = torch.Generator().manual_seed(7)
    # Rows of other grids follow, which must not be touched; the last grids are hashed.
    layout = coarsest_grids(grid_layout((*resolutions, 7), 8), len(resolutions))
    rows = grid_layout((*resolutions, 7), 8).rows
    u = torch.cat([torch.rand(300, 3, generator=generator), torch.eye(3), torch.ones(1, 3)])
    table = torch.randn(rows, 4, generator=generator, dtype=dtype).to(device)
    weight = torch.randn(len(u), len(resolutions) * 4, generator=generator, dtype=dtype).to(device)
    results = []
    for function in (grid_features_indexed, grid_features_reference):
        leaf = table.clone().requires_grad_(True)
        out = function(u.to(device, dtype), leaf, layout)
        (out * weight).sum().backward()
        assert leaf.grad is not None
        results.append((out.detach(), leaf.grad))
    (out, grad), (expected, expected_grad) = results
    tight = 1e-5 if dtype == torch.float32 else 1e-13  # sums are in another order
    assert torch.allclose(out, expected, rtol=0, atol=tight)
    assert torch.allclose(grad, expected_grad, rtol=0, atol=20 * tight)
    assert not bool(grad[layout.rows :].any()) and bool(grad.any())


@pytest.mark.parametrize("device", DEVICES)
def test_no_points_have_no_features_and_no_gradient(device: str) -> None:
    table = torch.ones(LAYOUT.rows, 4, device=device, requires_grad=True)
    out = grid_features_indexed(torch.empty(0, 3, device=device), table, LAYOUT)
    assert out.shape == (0, 16)
    out.sum().backward()
    assert table.grad is not None and not bool(table.grad.any())


@pytest.mark.parametrize("contract", [True, False])
def test_coordinates_stay_in_the_cube_and_keep_the_centre(contract: bool) -> None:
    far = torch.tensor([[1e6, -1e6, 3.0], [1.0, -2.0, 0.5], [-1e9, 0.0, 0.0]])
    u = grid_coordinates(far, frame(contract))
    assert bool(((u >= 0) & (u <= 1)).all())
    assert torch.allclose(u[1], torch.full((3,), 0.5))


def test_contraction_is_continuous_at_the_unit_ball() -> None:
    direction = torch.nn.functional.normalize(torch.tensor([[1.0, 2.0, -2.0]]), dim=1)
    center = torch.tensor([[1.0, -2.0, 0.5]])
    inside = grid_coordinates(center + 2.0 * 0.9999 * direction, frame(True))
    outside = grid_coordinates(center + 2.0 * 1.0001 * direction, frame(True))
    assert torch.allclose(inside, outside, atol=1e-4)


def test_straight_through_forward_is_a_hard_gather() -> None:
    generator = torch.Generator().manual_seed(5)
    logits, codebook = torch.randn(7, 5, generator=generator), torch.randn(5, 3)
    out = StraightThrough.apply(logits, codebook)
    assert torch.equal(out, codebook[logits.argmax(dim=1)])


def test_straight_through_backward_is_the_softmax_formula_in_float64() -> None:
    generator = torch.Generator().manual_seed(6)
    logits = torch.randn(7, 5, generator=generator, dtype=torch.float64).requires_grad_(True)
    codebook = torch.randn(5, 3, generator=generator, dtype=torch.float64).requires_grad_(True)
    grad = torch.randn(7, 3, generator=generator, dtype=torch.float64)
    StraightThrough.apply(logits, codebook).backward(grad)
    soft = logits.detach().requires_grad_(True)
    (soft.softmax(dim=1) @ codebook.detach()).backward(grad)
    assert soft.grad is not None and logits.grad is not None
    assert torch.allclose(logits.grad, soft.grad, atol=1e-12)
    expected = torch.zeros_like(codebook).index_add(0, logits.argmax(dim=1), grad)
    assert codebook.grad is not None and torch.allclose(codebook.grad, expected, atol=1e-12)
