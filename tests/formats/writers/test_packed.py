"""Our compressed PLY as other programs and our reader have it."""

from pathlib import Path

import numpy as np
import pytest
import torch

from gsynopsis.formats.readers.ply import read_ply
from gsynopsis.formats.writers.packed import neighbours, packed_bytes
from gsynopsis.model.bake import rotations
from gsynopsis.records import PlainGaussians
from tests.formats.scattered import scattered


def read_back(gaussians: PlainGaussians, folder: Path) -> PlainGaussians:
    path = folder / "a.compressed.ply"
    path.write_bytes(packed_bytes(gaussians))
    return read_ply(path).levels[-1]


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("count", [1, 256, 700])
def test_values_come_back_within_the_format_s_steps(
    degree: int, count: int, tmp_path: Path
) -> None:
    given = scattered(count, degree)
    order = neighbours(given.means)
    found = read_back(given, tmp_path)
    assert found.degree == degree
    size = np.ptp(given.means, axis=0).max()
    assert np.abs(found.means - given.means[order]).max() <= size / 1023 / 2 + 1e-6
    span = np.ptp(given.log_scales, axis=0).max()
    assert np.abs(found.log_scales - given.log_scales[order]).max() <= span / 1023 / 2 + 1e-6
    rest = found.sh[:, 1:] - given.sh[order, 1:]
    assert rest.size == 0 or np.abs(rest).max() <= 4 / 256 + 1e-6
    first = found.sh[:, 0] - given.sh[order, 0]
    assert np.abs(first).max() <= np.ptp(given.sh[:, 0], axis=0).max() / 255 / 2 + 1e-6
    turns = rotations(torch.tensor(found.quaternions)) - rotations(
        torch.tensor(given.quaternions[order])
    )
    assert float(turns.abs().max()) < 0.01


def test_values_of_the_largest_file_are_held_at_their_bounds(tmp_path: Path) -> None:
    g = scattered(3)
    g.sh[:, 1:] = np.array([9, -9, 0], np.float32)[:, None, None]
    g.log_scales[:] = -30
    found = read_back(g, tmp_path)
    assert np.sort(found.sh[:, 1, 0]).tolist() == [-4.0, pytest.approx(0, abs=1 / 64), 4.0]
    assert np.all(found.log_scales == -20)


def test_neighbours_share_a_chunk() -> None:
    given = scattered(4096, 0)
    order = neighbours(given.means)
    mixed, sorted_ = (
        np.ptp(given.means[rows].reshape(-1, 256, 3), axis=1).mean()
        for rows in (np.arange(4096), order)
    )
    assert sorted_ < 0.6 * mixed
