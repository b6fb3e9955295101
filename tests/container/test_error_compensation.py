"""Rounding in turn against its definition, one anchor and one linear system at a time."""

import numpy as np
import pytest

from gsynopsis.container import error_compensation as compensation
from gsynopsis.container.error_compensation import COMMON, UNSEEN, compensate_errors
from gsynopsis.container.layout import CodingId
from gsynopsis.container.values import column_steps, decode_values, encode_values, nearest_values
from gsynopsis.records import COUPLED, coupled_pairs


def make_coupling(rng: np.random.Generator, anchors: int, values: int, seen: int) -> np.ndarray:
    """Products of random derivatives, summed over `seen` pictures, of mixed strength."""
    first, second = coupled_pairs(values)
    shown = rng.normal(size=(seen, anchors, values)) * np.exp(rng.normal(size=(anchors, 1)))
    return (shown[..., first] * shown[..., second]).sum(axis=0).astype(np.float32)


def matrix(products: np.ndarray, values: int) -> np.ndarray:
    found = np.zeros((values, values))
    for product, first, second in zip(products, *coupled_pairs(values), strict=True):
        found[first, second] = found[second, first] = product
    return found


def normalised(products: np.ndarray, values: int, start: int) -> np.ndarray:
    own = matrix(products, values)[start : start + COUPLED, start : start + COUPLED]
    mean = np.trace(own) / len(own)
    return own / mean if mean else own


def by_definition(array: np.ndarray, step: float, coupling: np.ndarray) -> np.ndarray:
    """Each value to the nearest number of what it should be, given the errors before it."""
    coding, values = CodingId.CURVE8, array.shape[1]
    found = np.zeros(array.shape)
    columns = column_steps(coding, array, step)
    for row in range(len(array)):
        for start in range(0, values, COUPLED):
            width = min(COUPLED, values - start)
            weights = (1 - COMMON) * normalised(coupling[row], values, start)
            weights += COMMON * normalised(coupling.mean(axis=0, dtype=np.float64), values, start)
            weights += UNSEEN * np.eye(width)
            errors = np.zeros(0)
            for place in range(width):
                column = start + place
                # The best that values still to come can do is to follow the errors so far.
                rest, done = weights[place:, place:], weights[place:, :place]
                moved = np.linalg.solve(rest, done @ errors)[0] if place else 0.0
                wanted = np.array([float(array[row, column]) - moved])
                found[row, column] = nearest_values(coding, wanted, *columns[column])[0]
                errors = np.append(errors, found[row, column] - float(array[row, column]))
    return found


@pytest.mark.parametrize("values", [1, 5, COUPLED, COUPLED + 3])
def test_every_value_makes_up_for_the_errors_before_it(
    values: int, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compensation, "ROWS", 7)
    array = rng.normal(size=(20, values)).astype(np.float32)
    coupling = make_coupling(rng, 20, values, 3)
    coupling[4] = 0
    found = compensate_errors(CodingId.CURVE8, array, 0.1, coupling)
    np.testing.assert_array_equal(found, by_definition(array, 0.1, coupling).astype(np.float32))
    raw = encode_values(CodingId.CURVE8, found, 0.1)
    assert (decode_values(CodingId.CURVE8, raw, *found.shape) == found).all()


def test_pictures_lose_less_than_by_rounding_alone(rng: np.random.Generator) -> None:
    array = rng.normal(size=(500, 12)).astype(np.float32)
    coupling = make_coupling(rng, 500, 12, 6)

    def lost(found: np.ndarray) -> float:
        errors = found.astype(np.float64) - array
        pairs = zip(errors, coupling, strict=True)
        return sum(float(e @ matrix(products, 12) @ e) for e, products in pairs)

    raw = encode_values(CodingId.CURVE8, array, 0.1)
    alone = decode_values(CodingId.CURVE8, raw, *array.shape)
    assert lost(compensate_errors(CodingId.CURVE8, array, 0.1, coupling)) < 0.5 * lost(alone)


def test_values_that_are_not_coupled_are_rounded_alone(rng: np.random.Generator) -> None:
    array = rng.normal(size=(50, 4)).astype(np.float32)
    first, second = coupled_pairs(4)
    coupling = np.where(first == second, rng.uniform(0, 1, (50, 10)), 0).astype(np.float32)
    raw = encode_values(CodingId.CURVE8, array, 0.1)
    alone = decode_values(CodingId.CURVE8, raw, *array.shape)
    np.testing.assert_array_equal(compensate_errors(CodingId.CURVE8, array, 0.1, coupling), alone)
    none = np.zeros_like(coupling)
    np.testing.assert_array_equal(compensate_errors(CodingId.CURVE8, array, 0.1, none), alone)


def test_no_values_are_rounded_to_none() -> None:
    """A level may bring no anchors."""
    coupling = np.zeros((0, 10), np.float32)
    assert compensate_errors(
        CodingId.CURVE8, np.zeros((0, 4), np.float32), 0.1, coupling
    ).shape == (0, 4)
