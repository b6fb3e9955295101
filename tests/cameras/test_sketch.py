"""Fewer splats that show what all do."""

import numpy as np

from gsynopsis.cameras.sketch import thinned
from tests.formats.scattered import scattered


def test_few_splats_stay_as_they_are() -> None:
    splats = scattered(40)
    same = thinned(splats, 40)
    assert np.array_equal(same.means, splats.means)
    assert np.array_equal(same.log_scales, splats.log_scales)


def test_what_is_left_covers_as_much_by_fewer_larger_ones() -> None:
    splats = scattered(20_000)
    fewer = thinned(splats, 2_000)
    assert len(fewer) == 2_000 or abs(len(fewer) - 2_000) < 200
    rows = {tuple(mean): row for row, mean in enumerate(splats.means.tolist())}
    own = [rows[tuple(mean)] for mean in fewer.means.tolist()]  # they do not move
    growth = fewer.log_scales - splats.log_scales[own]
    assert (growth >= 0).all() and np.allclose(growth, growth[:, :1], atol=1e-5)
    # A chance p makes areas larger by 1 / p: the sum of areas times opacity stays.
    opacity = 1 / (1 + np.exp(-splats.logits.astype(np.float64)))
    area = np.exp(np.sort(splats.log_scales.astype(np.float64), axis=1)[:, 1:].sum(axis=1))
    whole = (opacity * area).sum()
    left = (opacity[own] * area[own] * np.exp(2 * growth[:, 0].astype(np.float64))).sum()
    assert abs(left / whole - 1) < 0.1
