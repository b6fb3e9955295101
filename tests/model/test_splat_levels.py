"""Splats as levels: their order, frame and codebooks."""

import numpy as np
import pytest

from gsynopsis.model.splat_levels import (
    Steps,
    as_stored,
    frame_of,
    row_order,
    small_scale,
    splat_levels,
    weights_by,
)
from gsynopsis.model.splats import SplatModel, decoder_of
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


def test_harmonics_of_splats_that_matter_are_kept_better() -> None:
    count, steps = 600, Steps(stages=2, books=1 / 4, price=0.01)
    splats, worth = scattered(count, degree=1), np.ones(count)
    order = row_order(splats, worth, [count], steps)
    heavy = np.arange(count) % 6 == 0
    lost = list[float]()
    for weights in (np.ones(count), np.where(heavy, 1.0, 0.01)):
        read = decoder_of(splat_levels(splats, worth, [count], {}, steps, weights=weights))
        assert isinstance(read, SplatModel)
        error = read.sh[:, 1:].numpy() - splats.sh[order, 1:]
        lost.append(float(np.square(error)[heavy[order]].mean()))
    assert lost[1] < 0.5 * lost[0]


def test_splats_that_show_nothing_weigh_something() -> None:
    assert np.array_equal(weights_by(np.zeros(3)), np.full(3, weights_by(np.zeros(1))[0]))
    weights = weights_by(np.array([0.0, 1.0, 4.0]))
    assert 0 < weights[0] < 0.1 * weights[1] and weights[2] == pytest.approx(2 * weights[1])
