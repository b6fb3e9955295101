"""The estimate of coding with a context against a slow twin, and what it finds."""

import numpy as np
import pytest

from benchmarks.size.contexts import (
    best_length,
    code_length,
    known_before,
    plain_length,
    symbols_of,
)


def slow_length(symbols: np.ndarray, contexts: np.ndarray, start: np.ndarray) -> float:
    counts, bits = np.tile(start, (int(contexts.max()) + 1, 1)), 0.0
    for symbol, context in zip(symbols, contexts, strict=True):
        bits -= np.log2(counts[context, symbol] / counts[context].sum())
        counts[context, symbol] += 1
    return bits


@pytest.mark.parametrize("start", [0.5, 40.0])
def test_a_length_is_that_of_coding_symbol_by_symbol(start: float) -> None:
    chance = np.random.default_rng(0)
    symbols, contexts = chance.integers(0, 9, 300), chance.integers(0, 4, 300)
    begun = start * chance.dirichlet(np.ones(9))
    found = code_length(symbols, contexts, begun)
    assert found == pytest.approx(slow_length(symbols, contexts, begun), rel=1e-9)
    assert code_length(symbols[:0], contexts[:0], begun) == 0


def test_symbols_begin_as_likely_as_a_logistic_distribution_has_them() -> None:
    column = np.rint(np.random.default_rng(3).logistic(2, 3, 20_000))
    symbols, shares = symbols_of(column)
    assert np.array_equal(np.unique(column)[symbols], column) and shares.sum() == pytest.approx(1)
    often = np.bincount(symbols) / len(symbols)
    assert np.abs(often - shares).max() < 0.01


def test_what_a_known_value_tells_is_saved_and_noise_is_not() -> None:
    chance = np.random.default_rng(1)
    known = chance.normal(size=4000)
    column = np.rint(2 * known + chance.normal(size=4000) / 4)
    plain, noise = plain_length(column), {"noise": chance.normal(size=4000)}
    assert best_length(column, {"known": known}) < 0.7 * plain
    assert best_length(column, noise) == pytest.approx(plain, rel=0.01)


def test_only_earlier_rows_are_known() -> None:
    places = np.random.default_rng(2).uniform(size=(200, 3))
    found = known_before(places)
    assert found[0] == 0 and (found[1:] < np.arange(1, 200)).all()
    away = np.linalg.norm(places[150] - places, axis=1)
    assert found[150] == np.argmin(np.where(np.arange(200) < 150, away, np.inf))
