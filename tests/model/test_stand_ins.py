"""Few splats that stand for many: their clusters, means and covariances."""

import numpy as np
import pytest

from gsynopsis.model.stand_ins import merged, nested_stand_ins, weighted_clusters
from gsynopsis.records import PlainGaussians


def some(rng: np.random.Generator, count: int, degree: int = 1) -> PlainGaussians:
    values = (
        rng.normal(size=(count, 3)),
        rng.normal(-3, 0.5, (count, 3)),
        rng.normal(size=(count, 4)),
        rng.normal(size=count),
        rng.normal(size=(count, (degree + 1) ** 2, 3)),
    )
    return PlainGaussians(*(value.astype(np.float32) for value in values))


def matrix(q: np.ndarray) -> np.ndarray:
    w, x, y, z = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def covariance(gaussians: PlainGaussians, row: int) -> np.ndarray:
    turned = matrix(gaussians.quaternions[row].astype(float))
    turned = turned * np.exp(gaussians.log_scales[row].astype(float))
    return turned @ turned.T


def plain_clusters(points: np.ndarray, weights: np.ndarray, count: int) -> np.ndarray:
    """The rule of `weighted_clusters`, one part after the other."""
    label = np.zeros(len(points), np.int64)

    def cut(rows: np.ndarray, wanted: int, first: int) -> None:
        if wanted == 1:
            label[rows] = first
            return
        own = points[rows]
        axis = int(np.argmax(own.max(axis=0) - own.min(axis=0)))
        rows = rows[np.lexsort((rows, own[:, axis]))]
        sums = np.cumsum(weights[rows])
        size = int(np.clip(np.searchsorted(sums, sums[-1] / 2) + 1, 1, len(rows) - 1))
        left = int(np.clip(np.rint(wanted * sums[size - 1] / sums[-1]), 1, wanted - 1))
        left = int(np.clip(left, wanted - (len(rows) - size), size))
        cut(rows[:size], left, first)
        cut(rows[size:], wanted - left, first + left)

    cut(np.arange(len(points)), count, 0)
    return label


@pytest.mark.parametrize("count", [1, 2, 7, 100, 1499, 1500])
@pytest.mark.parametrize("places", [3, 1 << 20])
def test_the_native_clusters_are_the_plain_ones(
    rng: np.random.Generator, count: int, places: int
) -> None:
    points = (rng.integers(0, places, (1500, 3)) * [1, 2, 0.5]).astype(np.float32)
    # Whole numbers, whose sums are exact in any order.
    weights = rng.integers(1, 2**10, 1500).astype(float)
    weights[0] = 2**12
    found = weighted_clusters(points, weights, count)
    assert np.array_equal(found, plain_clusters(points, weights, count))


@pytest.mark.parametrize("count", [1, 2, 7, 100, 299, 300])
def test_clusters_are_as_many_as_asked_for_and_none_is_empty(
    rng: np.random.Generator, count: int
) -> None:
    points = rng.normal(size=(300, 3)).astype(np.float32)
    weights = rng.random(300) + 1e-9
    sizes = np.bincount(weighted_clusters(points, weights, count))
    assert len(sizes) == count
    assert (sizes > 0).all()


def test_points_in_one_place_still_make_as_many_clusters() -> None:
    label = weighted_clusters(np.zeros((50, 3), np.float32), np.ones(50), 20)
    assert label.max() == 19 and len(np.unique(label)) == 20


def test_what_weighs_more_is_in_smaller_clusters(rng: np.random.Generator) -> None:
    points = rng.random((4000, 3)).astype(np.float32)
    heavy = points[:, 0] < 0.5
    label = weighted_clusters(points, np.where(heavy, 9.0, 1.0), 200)
    sizes = np.bincount(label)[label]
    assert np.median(sizes[heavy]) * 4 < np.median(sizes[~heavy])


def test_clusters_are_boxes_cut_where_half_of_the_weight_lies() -> None:
    points = np.zeros((8, 3), np.float32)
    points[:, 1] = np.arange(8)
    label = weighted_clusters(points, np.ones(8), 4)
    assert label.tolist() == [0, 0, 1, 1, 2, 2, 3, 3]
    label = weighted_clusters(points, np.array([7.0, 1, 1, 1, 1, 1, 1, 0.5]), 2)
    assert label.tolist() == [0, 1, 1, 1, 1, 1, 1, 1]


def test_a_merged_splat_has_the_moments_of_its_cluster(rng: np.random.Generator) -> None:
    splats, weights = some(rng, 40), rng.random(40) + 0.1
    label = rng.integers(0, 5, 40)
    found = merged(splats, label, 5, weights)
    assert found.degree == 0
    for cluster in range(5):
        rows = np.flatnonzero(label == cluster)
        share = weights[rows] / weights[rows].sum()
        mean = share @ splats.means[rows]
        away = splats.means[rows] - mean
        second = sum(
            s * (covariance(splats, row) + np.outer(d, d))
            for s, row, d in zip(share, rows, away, strict=True)
        )
        assert np.allclose(found.means[cluster], mean, atol=1e-5)
        assert np.allclose(covariance(found, cluster), second, rtol=1e-3, atol=1e-5)
        assert np.allclose(found.sh[cluster, 0], share @ splats.sh[rows, 0], atol=1e-5)


def test_a_cluster_of_one_is_that_splat(rng: np.random.Generator) -> None:
    splats = some(rng, 6, 0)
    found = merged(splats, np.arange(6), 6, np.ones(6))
    assert np.allclose(found.means, splats.means, atol=1e-6)
    assert np.allclose(found.logits, splats.logits, atol=1e-3)
    for row in range(6):
        assert np.allclose(covariance(found, row), covariance(splats, row), rtol=1e-4)


def test_each_level_covers_all_of_the_scene(rng: np.random.Generator) -> None:
    splats = some(rng, 500)
    found = nested_stand_ins(splats, rng.random(500), [10, 60])
    assert len(found) == 60
    for start, end in ((0, 10), (10, 60)):
        spread = found.means[start:end].std(axis=0)
        assert (spread > 0.4 * splats.means.std(axis=0)).all()
    again = nested_stand_ins(splats, np.zeros(500), [10, 60])
    assert np.isfinite(again.means).all()


def test_flat_splats_stay_thin_and_finite(rng: np.random.Generator) -> None:
    splats = some(rng, 9, 0)
    splats.log_scales[:, 2] = -60
    splats.means[:] = 0
    found = merged(splats, np.zeros(9, np.int64), 1, np.ones(9))
    assert np.isfinite(found.log_scales).all()
