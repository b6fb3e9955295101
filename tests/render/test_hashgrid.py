import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from gsynopsis._native import _core

PRIMES = (1, 2654435761, 805459861)
RESOLUTIONS = (2, 4, 9, 18, 59)
TABLE = 512  # rows at most, so that the last two levels are hashed
CORNERS = [(c & 1, c >> 1 & 1, c >> 2) for c in range(8)]


def layout(table: int = TABLE) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    sizes = np.array([min(table, -(-(r**3) // 8) * 8) for r in RESOLUTIONS], np.int64)
    return np.array(RESOLUTIONS, np.int64), np.cumsum(sizes) - sizes, sizes


def row_of(cell: tuple[int, int, int], resolution: int, size: int) -> int:
    """The index in Python integers, as the file format states it."""
    x, y, z = cell
    if resolution**3 <= size:
        return x + y * resolution + z * resolution**2
    hashed = 0
    for value, prime in zip(cell, PRIMES, strict=True):
        hashed ^= value * prime % 2**32
    return hashed % size


def corners(u: NDArray[np.float32], resolution: int) -> tuple[NDArray[np.int64], torch.Tensor]:
    """Lower corner [V, 3] and weights [V, 8]."""
    position = u * np.float32(resolution - 1)
    low = np.clip(np.floor(position), 0, resolution - 2)
    fraction = torch.as_tensor(position - low, dtype=torch.float64)
    weights = [
        torch.stack([fraction[:, k] if d else 1 - fraction[:, k] for k, d in enumerate(c)]).prod(0)
        for c in CORNERS
    ]
    return low.astype(np.int64), torch.stack(weights, dim=1)


def twin(u: NDArray[np.float32], tables: torch.Tensor, table: int = TABLE) -> torch.Tensor:
    columns = []
    for resolution, offset, size in zip(*layout(table), strict=True):
        low, weights = corners(u, int(resolution))
        rows = [
            [offset + row_of(tuple(int(x) for x in cell + c), int(resolution), int(size))
             for c in np.array(CORNERS)] for cell in low
        ]  # fmt: skip
        columns.append((weights[:, :, None] * tables[torch.tensor(rows)]).sum(1))
    return torch.cat(columns, dim=1)


def points(count: int = 60) -> NDArray[np.float32]:
    u = np.random.default_rng(0).uniform(0, 1, (count, 3)).astype(np.float32)
    u[:4] = [[0, 0, 0], [1, 1, 1], [0, 1, 0.5], [0.25, 0.5, 1]]
    return u


@pytest.mark.parametrize("variant", _core.variants())
@pytest.mark.parametrize("features", [1, 2, 4, 7])
@pytest.mark.parametrize("table", [TABLE, 500])  # 500: the remainder is not a mask
def test_values_and_gradient_are_those_of_the_twin(variant: str, features: int, table: int) -> None:
    resolutions, offsets, sizes = layout(table)
    rng = np.random.default_rng(1)
    tables = rng.normal(size=(int(sizes.sum()), features)).astype(np.float32)
    u = points()
    out = np.full((len(u), len(RESOLUTIONS) * features), np.nan, np.float32)
    _core.hashgrid_forward(u, tables, resolutions, offsets, sizes, out, 2, variant)
    leaf = torch.tensor(tables, dtype=torch.float64, requires_grad=True)
    expected = twin(u, leaf, table)
    np.testing.assert_allclose(out, expected.detach().numpy(), atol=2e-6)

    grad_out = rng.normal(size=out.shape).astype(np.float32)
    expected.backward(torch.tensor(grad_out, dtype=torch.float64))
    grad = np.ones_like(tables)  # added to, not overwritten
    _core.hashgrid_backward(u, grad_out, resolutions, offsets, sizes, grad, 2, variant)
    assert leaf.grad is not None
    np.testing.assert_allclose(grad - 1, leaf.grad.numpy(), atol=3e-5)


def test_every_variant_and_thread_count_gives_the_same_bits() -> None:
    resolutions, offsets, sizes = layout()
    rng = np.random.default_rng(2)
    tables = rng.normal(size=(int(sizes.sum()), 4)).astype(np.float32)
    u = points()
    results = set()
    for variant in _core.variants():
        for threads in (1, 2, 3):
            out = np.empty((len(u), len(RESOLUTIONS) * 4), np.float32)
            grad = np.zeros_like(tables)
            _core.hashgrid_forward(u, tables, resolutions, offsets, sizes, out, threads, variant)
            _core.hashgrid_backward(u, out, resolutions, offsets, sizes, grad, threads, variant)
            results.add((out.tobytes(), grad.tobytes()))
    assert len(results) == 1


def test_a_grid_node_reads_its_own_row() -> None:
    resolutions, offsets, sizes = layout()
    tables = np.arange(int(sizes.sum()), dtype=np.float32)[:, None].copy()
    level = 3
    resolution, size = int(resolutions[level]), int(sizes[level])
    cell = (5, 11, 16)
    u = np.array([[(c + 1e-6) / (resolution - 1) for c in cell]], np.float32)
    out = np.empty((1, len(RESOLUTIONS)), np.float32)
    _core.hashgrid_forward(u, tables, resolutions, offsets, sizes, out)
    assert out[0, level] == pytest.approx(offsets[level] + row_of(cell, resolution, size), abs=0.1)


def test_no_points_and_points_outside_stay_inside_the_tables() -> None:
    resolutions, offsets, sizes = layout()
    tables = np.ones((int(sizes.sum()), 2), np.float32)
    for u in (np.empty((0, 3)), np.array([[-3, 7, np.nan], [np.inf, -np.inf, 1e30]])):
        out = np.empty((len(u), len(RESOLUTIONS) * 2), np.float32)
        grad = np.zeros_like(tables)
        u32 = u.astype(np.float32)
        _core.hashgrid_forward(u32, tables, resolutions, offsets, sizes, out)
        _core.hashgrid_backward(u32, out, resolutions, offsets, sizes, grad)
        assert grad.shape == tables.shape


def test_wrong_arrays_are_refused_by_name() -> None:
    resolutions, offsets, sizes = layout()
    tables = np.ones((int(sizes.sum()), 2), np.float32)
    u, out = points(4), np.empty((4, len(RESOLUTIONS) * 2), np.float32)
    with pytest.raises(TypeError, match="points: wrong element type"):
        _core.hashgrid_forward(
            u.astype(np.float64),  # pyright: ignore[reportArgumentType]
            tables, resolutions, offsets, sizes, out,
        )  # fmt: skip
    with pytest.raises(ValueError, match="out: found 9 columns, expected at least 10"):
        _core.hashgrid_forward(u, tables, resolutions, offsets, sizes, out[:, 1:].copy())
    with pytest.raises(ValueError, match="points: must be contiguous"):
        _core.hashgrid_forward(u[::2], tables, resolutions, offsets, sizes, out[:2])
    with pytest.raises(ValueError, match="outside of tables"):
        _core.hashgrid_forward(u, tables[1:], resolutions, offsets, sizes, out)
    with pytest.raises(ValueError, match="resolutions: expected 2"):
        _core.hashgrid_forward(u, tables, resolutions * 0, offsets, sizes, out)
    with pytest.raises(ValueError, match="variant"):
        _core.hashgrid_forward(u, tables, resolutions, offsets, sizes, out, variant="mmx")
