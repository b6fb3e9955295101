"""Lattice cells: exact round trips, no duplicates."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gsynopsis.model.lattice import (
    KEY_LIMIT,
    auto_voxel,
    beyond_lattice,
    free_cells,
    initial_lattice,
    initial_log_scales,
    lattice_keys,
)
from gsynopsis.records import Frame, positions

CELLS = hnp.arrays(np.int64, st.tuples(st.integers(1, 40), st.just(3)), elements=st.integers(-5, 5))


def test_positions_round_to_their_own_cell_again(rng: np.random.Generator) -> None:
    lattice = rng.integers(-KEY_LIMIT, KEY_LIMIT, (1000, 3)).astype(np.int32)
    for voxel in (1e-3, 0.37, 12.5):
        frame = Frame(voxel, np.zeros(3), 1.0, True, 1.0)
        back = np.round(positions(frame, lattice).astype(np.float64) / voxel)
        assert np.array_equal(back, lattice)


def test_keys_differ_for_different_cells(rng: np.random.Generator) -> None:
    cells = np.unique(rng.integers(-KEY_LIMIT, KEY_LIMIT, (5000, 3)), axis=0)
    assert len(np.unique(lattice_keys(cells))) == len(cells)


@given(CELLS, CELLS)
def test_free_cells_are_exactly_the_new_ones(wanted: np.ndarray, there: np.ndarray) -> None:
    cells, rows = free_cells(wanted, there)
    expected = {tuple(c) for c in wanted} - {tuple(c) for c in there}
    assert {tuple(c) for c in cells} == expected and len(cells) == len(expected)
    for cell, row in zip(wanted, rows, strict=True):
        assert (tuple(cells[row]) == tuple(cell)) if row >= 0 else tuple(cell) not in expected


def test_cells_beyond_the_key_range_are_never_grown() -> None:
    wanted = np.array([[KEY_LIMIT, 0, 0], [1, 2, 3], [0, -KEY_LIMIT - 1, 0]])
    cells, rows = free_cells(wanted, np.zeros((0, 3), np.int64))
    assert cells.tolist() == [[1, 2, 3]] and rows.tolist() == [-1, 0, -1]


def test_the_voxel_is_the_median_nearest_distance() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [10, 0, 0], [12, 0, 0], [30, 0, 0], [31, 0, 0]])
    assert auto_voxel(points) == 1.0


def test_coinciding_points_still_give_a_voxel_and_scales() -> None:
    points = np.zeros((4, 3))
    voxel = auto_voxel(points)
    assert voxel > 0 and len(initial_lattice(points, voxel)) == 1
    assert np.isfinite(initial_log_scales(np.zeros((1, 3)), voxel)).all()


def test_scales_are_the_root_mean_square_distance_to_three_neighbours() -> None:
    corners = np.array([[0.0, 0, 0], [3, 0, 0], [0, 4, 0], [0, 0, 12]])
    expected = 0.5 * np.log((9 + 16 + 144) / 3)
    assert np.allclose(initial_log_scales(corners, 1.0)[0], expected)


def test_points_beyond_the_keys_are_left_out_and_counted() -> None:
    points = np.array([[0.0, 0, 0], [0, KEY_LIMIT - 1, 0], [0, 0, -KEY_LIMIT], [1e300, 0, 0]])
    assert initial_lattice(points, 1.0).tolist() == [[0, 0, 0], [0, KEY_LIMIT - 1, 0]]
    assert beyond_lattice(points, 1.0) == 2 and beyond_lattice(points, 1e-300) == 3


def test_the_voxel_of_a_single_point_is_that_of_the_scene() -> None:
    assert auto_voxel(np.ones((1, 3)), 2048.0) == 2.0
