from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsynopsis.container import decode, encode
from gsynopsis.container.rounding import GRAIN, REACH, STEP_EXPONENT, gauge_fix_scales, rounded
from gsynopsis.container.writer import encode_with_account
from gsynopsis.records import LevelSet, Sensitivity, coupled_pairs
from tests.level_sets import BOTH, SHAPES, Shape, assert_same, make_level_set

LARGE = Shape(anchors=(200, 900, 2000), grids=(1, 2, 3), residual=5, hidden=2)


def make_sensitivity(
    rng: np.random.Generator, levels: LevelSet, spread: float = 1.0
) -> Sensitivity:
    """Of all values about the same part of a picture, but for factors of e^spread."""

    def some(array: np.ndarray) -> np.ndarray:
        return np.exp(rng.normal(0, spread, array.shape)).astype(np.float32) * 0.01

    shared = levels.shared
    residual = some(shared.residual)
    first, second = coupled_pairs(residual.shape[1])
    return Sensitivity(
        some(shared.log_scales),
        some(shared.offsets),
        residual,
        grids=[some(grid) for grid in shared.grids],
        coupling=np.where(first == second, residual[:, first], np.float32(0)),
    )


def places(levels: LevelSet) -> np.ndarray:
    """Offsets of live slots in world units."""
    scales = np.exp(levels.shared.log_scales[:, None, :3].astype(np.float64))
    return (levels.shared.offsets * scales)[levels.levels[-1].mask]


def error(given: LevelSet, found: LevelSet, sensitivity: Sensitivity) -> float:
    """The loss that a sensitivity promises, by definition: world offsets, all else as it is."""
    live, used = given.levels[-1].mask, given.levels[-1].grids
    scales = np.exp(given.shared.log_scales[:, None, :3].astype(np.float64))
    shape = (*live.shape, 3)
    apart = (places(found) - places(given)) / np.broadcast_to(scales, shape)[live]
    total = float((sensitivity.offsets[live] * apart**2).sum())
    one, two = given.shared, found.shared
    rest: Sequence[tuple[np.ndarray, ...]] = [
        (one.log_scales[:, 3:], two.log_scales[:, 3:], sensitivity.log_scales[:, 3:]),
        (one.residual, two.residual, sensitivity.residual),
        *zip(one.grids[:used], two.grids[:used], sensitivity.grids[:used], strict=True),
    ]
    return total + sum(float((w * (a.astype(np.float64) - b) ** 2).sum()) for a, b, w in rest)


def test_balanced_scales_are_few_and_nothing_moves(rng: np.random.Generator) -> None:
    levels = make_level_set(rng, LARGE)
    sensitivity = make_sensitivity(rng, levels, 2.0)
    found, moved = gauge_fix_scales(levels, sensitivity)
    scales = found.shared.log_scales[:, :3]
    assert (scales / GRAIN == np.rint(scales / GRAIN)).all()
    assert (scales == scales[:, :1]).all()
    assert 2 < len(np.unique(scales)) < 30
    assert (found.shared.log_scales[:, 3:] == levels.shared.log_scales[:, 3:]).all()
    np.testing.assert_allclose(places(found), places(levels), rtol=1e-6)
    reached = found.shared.offsets[found.levels[-1].mask]
    assert float(np.abs(reached).max()) <= REACH * 1.0001
    # What an error in world units costs is a matter of the picture alone.
    before = sensitivity.offsets / np.exp(2 * levels.shared.log_scales[:, None, :3])
    after = moved.offsets / np.exp(2 * found.shared.log_scales[:, None, :3])
    np.testing.assert_allclose(after, before, rtol=1e-5)


def test_scales_are_larger_where_offsets_show_less(rng: np.random.Generator) -> None:
    levels = make_level_set(rng, LARGE)
    scales = levels.shared.log_scales.copy()
    scales[:, :3] = -4
    offsets = np.clip(levels.shared.offsets, -0.5, 0.5)
    levels = replace(levels, shared=replace(levels.shared, log_scales=scales, offsets=offsets))
    even = make_sensitivity(rng, levels, 0.0)
    weights = even.offsets.copy()
    weights[::2] *= 1e6
    found, _ = gauge_fix_scales(levels, replace(even, offsets=weights))
    faint, shown = found.shared.log_scales[1::2, :3], found.shared.log_scales[::2, :3]
    assert float(faint.min()) > float(shown.max())


@pytest.mark.parametrize("name", sorted({*SHAPES} - {"empty"}))
@pytest.mark.parametrize("block", [4, 16_384])
def test_a_file_holds_rounded_values_exactly(
    name: str, block: int, rng: np.random.Generator
) -> None:
    levels = make_level_set(rng, SHAPES[name])
    found = rounded(levels, make_sensitivity(rng, levels), 0.05)
    data = encode_with_account(found, "compact", block=block)[0]
    read = decode(data, "rounded").shared
    kept = found.upto(len(found.levels) - 1).shared
    assert (read.log_scales == kept.log_scales).all()
    assert (read.offsets == kept.offsets).all()
    assert (read.residual == kept.residual).all()
    assert all((a == b).all() for a, b in zip(read.grids, kept.grids, strict=True))


def test_a_set_without_anchors_stays(rng: np.random.Generator) -> None:
    levels = make_level_set(rng, SHAPES["empty"])
    assert rounded(levels, make_sensitivity(rng, levels), 0.05) is levels


def test_the_loss_is_what_was_ordered_and_bytes_fall_with_it(rng: np.random.Generator) -> None:
    levels = make_level_set(rng, LARGE)
    # Slots as far from their anchor along one axis as along another, about, as in real scenes:
    # else 256 numbers are too few for the smallest of these losses.
    scales = levels.shared.log_scales.copy()
    scales[:, :3] = scales[:, :1]
    levels = replace(levels, shared=replace(levels.shared, log_scales=scales))
    sensitivity = make_sensitivity(rng, levels)
    sizes: list[int] = []
    for loss in (0.06, 0.3, 1.5):
        found = rounded(levels, sensitivity, loss)
        assert 0.7 * loss <= error(levels, found, sensitivity) <= loss
        sizes.append(len(encode(found)))
    assert sizes[0] > sizes[1] > sizes[2]


def test_residual_values_of_an_anchor_make_up_for_each_other(rng: np.random.Generator) -> None:
    levels = make_level_set(rng, LARGE)
    alone = make_sensitivity(rng, levels, 0.0)
    together = replace(alone, coupling=np.full_like(alone.coupling, 0.01))
    one, two = (rounded(levels, weights, 0.3).shared for weights in (alone, together))

    def lost(found: np.ndarray) -> float:
        return float((found - levels.shared.residual).sum(axis=1, dtype=np.float64).var())

    assert lost(two.residual) < 0.3 * lost(one.residual)
    assert len(np.unique(two.residual)) == pytest.approx(len(np.unique(one.residual)), rel=0.1)
    assert (two.offsets == one.offsets).all()


def test_what_shows_less_gets_longer_steps(rng: np.random.Generator) -> None:
    levels = make_level_set(rng, LARGE)
    even = make_sensitivity(rng, levels, 0.0)
    faint = replace(even, residual=even.residual * 1e-3)
    counts = [
        len(np.unique(rounded(levels, weights, 0.1).shared.residual[:, 0]))
        for weights in (even, faint)
    ]
    assert counts[0] > 4 * counts[1]


def test_levels_that_show_less_get_longer_steps(rng: np.random.Generator) -> None:
    levels = make_level_set(rng, LARGE)
    even, count = make_sensitivity(rng, levels, 0.0), levels.levels[0].anchors
    finer = np.arange(len(levels.shared.lattice)) >= count
    scales, residual = even.log_scales.copy(), even.residual.copy()
    scales[finer] *= 1e-3
    residual[finer] *= 1e-3
    apart = replace(even, log_scales=scales, residual=residual)

    def steps(weights: Sensitivity) -> list[float]:
        shared = rounded(levels, weights, 0.1).shared
        columns = (shared.log_scales[:, 3], shared.residual[:, 0])
        parts = [part for column in columns for part in (column[~finer], column[finer])]
        return [float(np.diff(np.unique(part)).min()) for part in parts]

    one, two, three, four = steps(even)
    assert (one, three) == (two, four)
    one, two, three, four = steps(apart)
    assert two / one == pytest.approx(1e3**STEP_EXPONENT, rel=0.1)
    assert four / three == pytest.approx(1e3**STEP_EXPONENT, rel=0.1)


def test_values_that_nothing_shows_do_no_harm(rng: np.random.Generator) -> None:
    levels = make_level_set(rng, BOTH)
    even = make_sensitivity(rng, levels)
    none = Sensitivity(
        np.zeros_like(even.log_scales),
        np.zeros_like(even.offsets),
        np.zeros_like(even.residual),
        [np.zeros_like(grid) for grid in even.grids],
        np.zeros_like(even.coupling),
    )
    found = rounded(levels, none, 0.05)
    assert all(
        np.isfinite(array).all()
        for array in (found.shared.offsets, found.shared.log_scales, found.shared.residual)
    )
    assert len(encode(found)) < len(encode(levels))


@given(st.sampled_from(sorted(SHAPES)), st.integers(0, 2**32 - 1), st.floats(1e-3, 1.0))
def test_rounding_again_changes_nothing(name: str, seed: int, loss: float) -> None:
    rng = np.random.default_rng(seed)
    levels = make_level_set(rng, SHAPES[name])
    once = rounded(levels, make_sensitivity(rng, levels), loss)
    stored = decode(encode(once), "once")
    assert_same(stored, decode(encode(stored), "twice"))
    assert once.levels == levels.levels
