"""Rounding with error compensation among the values of one anchor, as in GPTQ (ours).

Rounded one by one, values of an anchor err independently. But images are far more sensitive to
some directions of the 12 than to others. So each value in turn takes the nearest number, and those
still to come move to where they compensate its error best. Optimal Brain Quantisation and GPTQ do
the same with the weights of a layer; here it is one small matrix per anchor, the JᵀJ of its values.
"""

import numpy as np
from numpy.typing import NDArray

from gsynopsis.container.layout import CodingId
from gsynopsis.container.values import column_steps, nearest_values
from gsynopsis.records import COUPLED, Float32, coupled_pairs

Float64 = NDArray[np.float64]

COMMON = 0.1
"""Part of the coupling that is the mean of all anchors: one anchor is seen by few images."""
UNSEEN = 0.05
"""Sensitivity of every direction, in parts of the anchor's mean: held-out views show directions
that no training view does."""
ROWS = 8192
"""Anchors at a time."""


def compensate_errors(coding: CodingId, array: Float32, step: float, coupling: Float32) -> Float32:
    """Values that a coding holds exactly, nearest where images are most sensitive.

    Args:
        coding: A stepped one.
        array: [N, R] residual values; not modified.
        step: The shortest step worth taking.
        coupling: [N, P], see `Sensitivity`.
    """
    found = np.empty_like(array)
    if not array.size:  # a level may bring no anchors
        return found
    columns = column_steps(coding, array, step)
    firsts, seconds = coupled_pairs(array.shape[1])
    for start in range(0, array.shape[1], COUPLED):
        stop = min(start + COUPLED, array.shape[1])
        own = (firsts >= start) & (firsts < stop)
        pairs = firsts[own] - start, seconds[own] - start
        common = _matrices(coupling[:, own].mean(axis=0, dtype=np.float64)[None], pairs)
        for row in range(0, len(array), ROWS):
            rows = slice(row, row + ROWS)
            matrices = _matrices(coupling[rows, own], pairs)
            mixed = (1 - COMMON) * matrices + COMMON * common + UNSEEN * np.eye(stop - start)
            values = array[rows, start:stop].astype(np.float64)
            found[rows, start:stop] = _in_turn(coding, values, columns[start:stop], mixed)
    return found


def _matrices(products: NDArray[np.floating], pairs: tuple[NDArray[np.int64], ...]) -> Float64:
    """Symmetric [n, W, W] from [n, P], with a mean diagonal of 1 (or of 0 where all is 0)."""
    first, second = pairs
    width = int(second.max()) + 1
    found = np.zeros((len(products), width, width))
    found[:, first, second] = found[:, second, first] = products
    mean = np.trace(found, axis1=1, axis2=2) / width
    return found / np.where(mean > 0, mean, 1)[:, None, None]


def _in_turn(
    coding: CodingId, values: Float64, columns: list[tuple[float, float]], matrices: Float64
) -> Float32:
    """Each column [n] of values [n, W] rounded, then the rest moved against its error.

    Rows of the upper Cholesky factor of the inverse say by how much (Frantar et al., GPTQ).
    `values` is used up.
    """
    factors = np.linalg.cholesky(np.linalg.inv(matrices)).transpose(0, 2, 1)
    found = np.empty(values.shape, np.float32)
    for column, (low, step) in enumerate(columns):
        found[:, column] = nearest_values(coding, values[:, column], low, step)
        error = (values[:, column] - found[:, column]) / factors[:, column, column]
        values[:, column + 1 :] -= error[:, None] * factors[:, column, column + 1 :]
    return found
