"""Splats that each stand for a cluster of others (ours): what coarse levels of an import begin as.

Letters: G splats, N clusters.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from gsynopsis._native import _core
from gsynopsis.model.bake import quaternions, rotations
from gsynopsis.model.splats import joined_gaussians
from gsynopsis.records import PlainGaussians

Int64 = NDArray[np.int64]
Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
POWER = 0.5
"""Exponent of removal effects as weights: clusters of what matters have fewer splats."""
LIGHTEST = 1e-9
"""Least weight in units of the largest, so that none is lost in rounding."""
FAINTEST, OPAQUEST = 0.05, 0.98
"""Opacities that a merged splat begins with: training can move either."""
CHUNK = 1 << 18
"""Splats whose covariances are in memory at once."""
UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def nested_stand_ins(
    gaussians: PlainGaussians, worth: Float64, counts: Sequence[int]
) -> PlainGaussians:
    """Stand-ins for all splats at each of some nested levels, without harmonics beyond the first.

    Each level adds a set of its own that covers the whole scene, as fine as its number allows.

    Args:
        gaussians: G of them.
        worth: Contribution of each to images, [G] ≥ 0.
        counts: Stand-ins of each level, rising, at most G.

    Returns:
        The stand-ins, those of level 0 first.
    """
    least = 1e-6 * max(float(worth.max(initial=0.0)), 1e-300)
    weights = np.maximum(worth, least) ** POWER
    parts = [
        merged(gaussians, weighted_clusters(gaussians.means, weights, own), own, worth + least)
        for own in np.diff(counts, prepend=0).tolist()
    ]
    return joined_gaussians(parts)


def weighted_clusters(points: Float32, weights: Float64, count: int) -> Int64:
    """The cluster of each point, 0 to N - 1, none of them empty, int64 [G].

    A k-d tree: parts are cut across their longest side where half of their weight lies, and each
    side has clusters in proportion to its weight, one at least.

    Args:
        points: [G, 3], finite.
        weights: [G] > 0.
        count: N, 1 to G.
    """
    labels = np.empty(len(points), np.int64)
    largest = max(float(weights.max()), 1e-300)
    heavy = np.maximum(weights / largest, LIGHTEST).astype(np.float32)
    _core.weighted_clusters(np.ascontiguousarray(points), heavy, count, labels)
    return labels


def merged(gaussians: PlainGaussians, label: Int64, count: int, weights: Float64) -> PlainGaussians:
    """One splat for each cluster: mean, covariance and colour are its weighted ones.

    Opacity is that with which it covers about as much as its splats together.

    Args:
        gaussians: G of them; of their harmonics the first alone are used.
        label: Cluster of each [G]; every cluster has one.
        count: N.
        weights: [G] > 0.
    """
    share = weights / np.bincount(label, weights, count)[label]
    means = _sums(label, share, gaussians.means, count)
    upper = np.zeros((count, len(UPPER)))
    for rows, covariance in _covariances(gaussians, means, label):
        for column, (i, j) in enumerate(UPPER):
            own = share[rows] * covariance[:, i, j]
            upper[:, column] += np.bincount(label[rows], own, count)
    whole = np.zeros((count, 3, 3))
    for column, (i, j) in enumerate(UPPER):
        whole[:, i, j] = whole[:, j, i] = upper[:, column]
    variances, axes = np.linalg.eigh(whole)
    axes[np.linalg.det(axes) < 0, :, 2] *= -1
    # What is flat stays thin, and its logarithm finite.
    log_scales = np.log(np.maximum(variances, 1e-12 * variances[:, 2:] + 1e-30)) / 2
    opacities = 1 / (1 + np.exp(-gaussians.logits.astype(np.float64)))
    covered = np.bincount(label, opacities * _areas(gaussians.log_scales), count)
    opacities = np.clip(covered / np.maximum(_areas(log_scales), 1e-300), FAINTEST, OPAQUEST)
    values = (
        means,
        log_scales,
        quaternions(torch.from_numpy(axes)).numpy(),
        np.log(opacities) - np.log1p(-opacities),
        _sums(label, share, gaussians.sh[:, 0], count)[:, None],
    )
    return PlainGaussians(*(value.astype(np.float32) for value in values))


def _sums(label: Int64, share: Float64, values: NDArray[np.float32], count: int) -> Float64:
    """Sums over clusters of [G, C], each value with its share, [N, C]."""
    found = np.zeros((count, values.shape[1]))
    for number, column in enumerate(values.T):
        found[:, number] = np.bincount(label, share * column, count)
    return found


def _covariances(
    gaussians: PlainGaussians, means: Float64, label: Int64
) -> Iterator[tuple[slice, Float64]]:
    """Covariances of splats around the means of their clusters, [n, 3, 3], some rows at a time."""
    for start in range(0, len(label), CHUNK):
        rows = slice(start, start + CHUNK)
        turns = rotations(torch.from_numpy(gaussians.quaternions[rows]).double()).numpy()
        turns = turns * np.exp(gaussians.log_scales[rows].astype(np.float64))[:, None]
        away = gaussians.means[rows] - means[label[rows]]
        yield rows, turns @ turns.transpose(0, 2, 1) + away[:, :, None] * away[:, None]


def _areas(log_scales: NDArray[np.floating]) -> Float64:
    """Products of the two larger scales, [G]."""
    return np.exp(np.sort(log_scales.astype(np.float64), axis=1)[:, 1:].sum(axis=1))
