"""Splats as levels: their order, frame and codebooks."""

import numpy as np
import pytest

from gsynopsis.model.splat_levels import Steps, as_stored, frame_of, row_order, small_scale
from tests.formats.scattered import scattered


def test_the_worthiest_splats_are_in_the_first_level() -> None:
    splats, worth = scattered(60), np.random.default_rng(0).random(60)
    order = row_order(splats, worth, [10, 25, 60], Steps())
    assert sorted(order.tolist()) == list(range(60))
    ranked = np.argsort(-worth)
    assert set(order[:10].tolist()) == set(ranked[:10].tolist())
    assert set(order[10:25].tolist()) == set(ranked[10:25].tolist())


def test_cells_are_a_share_of_a_small_splat_and_hold_the_farthest() -> None:
    splats = scattered(400)
    middle = np.exp(np.sort(splats.log_scales, axis=1)[:, 1])
    assert (middle < small_scale(splats)).mean() == pytest.approx(0.1, abs=0.01)
    frame = frame_of(splats, Steps(position=0.25))
    assert frame.voxel == pytest.approx(0.25 * small_scale(splats), rel=1e-6)
    assert np.abs(splats.means).max() / frame.voxel < 2**31


def test_a_stored_codebook_has_255_steps_to_a_column_and_is_found_again() -> None:
    book = np.random.default_rng(0).normal(size=(64, 5)).astype(np.float32) * [1, 0.01, 7, 0, 1]
    stored = as_stored(book.astype(np.float32))
    assert np.array_equal(as_stored(stored), stored)
    most = np.abs(book).max(axis=0)
    assert (np.abs(stored - book).max(axis=0) <= most / 127 + 1e-6).all()
    assert all(len(np.unique(column)) <= 255 for column in stored.T)
