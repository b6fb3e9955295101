"""Clusters hold each splat once, and each has a cell of its own."""

import numpy as np
import pytest

from gsynopsis.model.lattice import KEY_LIMIT
from gsynopsis.teacher.clusters import apart, clustered, clusters_of, lattice_cell


@pytest.mark.parametrize("count", [1, 3, 16, 17, 500])
def test_clusters_are_full_but_one_and_hold_each_point_once(
    count: int, rng: np.random.Generator
) -> None:
    points = rng.standard_normal((count, 3)) * (1, 5, 0.1)
    label, clusters = clustered(points, 16)
    sizes = np.bincount(label)
    assert len(sizes) == clusters == -(-count // 16)
    assert (sizes < 16).sum() <= 1 and sizes.max() <= 16
    voxel = lattice_cell(points, label, clusters)
    found = clusters_of(points, np.ones(count), label, clusters, voxel, 16)
    assert sorted(found.members[found.members >= 0].tolist()) == list(range(count))
    assert np.array_equal(found.lattice, np.unique(found.lattice, axis=0))
    # An anchor is among its own.
    places = found.lattice * voxel
    for place, members in zip(places, found.members, strict=True):
        own = points[members[members >= 0]]
        assert (np.abs(place - own.mean(axis=0)) <= 9 * voxel).all()


def test_a_cluster_lies_together(rng: np.random.Generator) -> None:
    points = rng.random((4096, 3))
    label, count = clustered(points, 16)
    reach = [np.ptp(points[label == one], axis=0).max() for one in range(count)]
    assert np.median(reach) < 3 / count ** (1 / 3)


def test_points_in_one_place_get_cells_side_by_side_as_far_as_there_are_some() -> None:
    points = np.full((32, 3), 0.5)
    label, count = clustered(points, 4)
    voxel = lattice_cell(points, label, count)
    found = clusters_of(points, np.ones(32), label, count, voxel, 4)
    assert len(found.lattice) == 8 and (found.members >= 0).all()
    cells, unique = apart(np.zeros((5000, 3), np.int64))
    assert unique.sum() == 17**3 and len(np.unique(cells[unique], axis=0)) == 17**3


def test_cells_stay_on_the_lattice() -> None:
    cells, unique = apart(np.full((3, 3), KEY_LIMIT - 1))
    assert unique.all() and cells.max() < KEY_LIMIT
