"""Colors that change with the direction tell from where photos were taken."""

import numpy as np
import pytest
import torch

from gsynopsis.cameras.view_dependence import ViewDependence
from gsynopsis.formats.axes import harmonic_values
from gsynopsis.model.harmonics import harmonic_colors

CHANCE = np.random.default_rng(7)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def fitted(points: int, to: np.ndarray, count: int = 15) -> ViewDependence:
    """Points after a step, from zero, towards colors by chance in directions [D, 3] to photos."""
    values = harmonic_values(-unit(to), 1 + count)[:, 1:]
    harmonics = 0.01 * values.T @ CHANCE.standard_normal((points, len(to), 3))
    return ViewDependence(CHANCE.standard_normal((points, 3)), harmonics.astype(np.float32))


@pytest.mark.parametrize("count", [3, 8, 15])
def test_change_is_that_of_rendered_colors(count: int) -> None:
    """Against the renderer's own harmonics, and their mean over many directions."""
    dependence = ViewDependence(
        CHANCE.standard_normal((5, 3)),
        0.05 * CHANCE.standard_normal((5, count, 3)).astype(np.float32),
    )
    place, rows = np.array([1.0, 2.0, 3.0]), np.array([0, 2, 3])
    sh = torch.zeros(3, 1 + count, 3)
    sh[:, 1:] = torch.from_numpy(dependence.harmonics[rows])

    def change(away: np.ndarray) -> np.ndarray:
        seen = harmonic_colors(sh, torch.from_numpy(away).float())
        return seen.double().numpy() - 0.5

    here = np.linalg.norm(change(dependence.points[rows] - place), axis=1).sum()
    around = [change(np.tile(one, (3, 1))) for one in CHANCE.standard_normal((4000, 3))]
    mean = np.sqrt((np.stack(around) ** 2).sum(axis=2).mean(axis=0)).sum()
    assert dependence.towards(place, rows) == pytest.approx(here / mean, rel=0.03)


@pytest.mark.parametrize("axis", [(0, -1, 0), (0, 0, 1), (0.6, 0, 0.8)])
def test_photos_of_one_side_are_found(axis: tuple[float, float, float]) -> None:
    to = np.array(axis) + 0.3 * CHANCE.standard_normal((40, 3))
    found = fitted(300, to).mean_direction()
    assert np.linalg.norm(found) > 0.3
    assert unit(found) @ np.array(axis) > np.cos(np.radians(10))


def test_photos_from_all_around_leave_their_height() -> None:
    turn = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn), np.full(60, 0.7)], axis=1)
    found = fitted(300, ring).mean_direction()
    assert np.linalg.norm(found) > 0.1
    assert unit(found)[2] > np.cos(np.radians(15))


def test_noise_tells_nothing() -> None:
    """As SOG's few vectors of harmonics, where each splat has the nearest."""
    noise = 0.1 * CHANCE.standard_normal((2000, 15, 3)).astype(np.float32)
    dependence = ViewDependence(CHANCE.standard_normal((2000, 3)), noise)
    assert np.linalg.norm(dependence.mean_direction()) < 0.04


@pytest.mark.parametrize("count", [0, 15])
def test_colors_that_do_not_change_tell_nothing(count: int) -> None:
    dependence = ViewDependence(CHANCE.standard_normal((9, 3)), np.zeros((9, count, 3), np.float32))
    assert dependence.towards(np.zeros(3), np.arange(9)) == 1
    assert np.linalg.norm(dependence.mean_direction()) < 1e-9
    assert dependence.towards(np.zeros(3), np.zeros(0, int)) == 1
