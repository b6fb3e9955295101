"""Colors that change with the direction tell from where photos were taken."""

import numpy as np
import pytest
import torch

from gsynopsis.cameras.view_dependence import color_change, photo_direction
from gsynopsis.model.harmonics import harmonic_colors
from tests.cameras.splat_scenes import after_a_step

CHANCE = np.random.default_rng(7)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


@pytest.mark.parametrize("count", [3, 8, 15])
def test_change_is_that_of_rendered_colors(count: int) -> None:
    """Against the renderer's own harmonics, and their mean over many directions."""
    harmonics = 0.05 * CHANCE.standard_normal((3, count, 3)).astype(np.float32)
    away = CHANCE.standard_normal((3, 3))
    sh = torch.zeros(3, 1 + count, 3)
    sh[:, 1:] = torch.from_numpy(harmonics)

    def change(away: np.ndarray) -> np.ndarray:
        seen = harmonic_colors(sh, torch.from_numpy(away).float())
        return seen.double().numpy() - 0.5

    here = np.linalg.norm(change(away), axis=1).sum()
    around = [change(np.tile(one, (3, 1))) for one in CHANCE.standard_normal((4000, 3))]
    mean = np.sqrt((np.stack(around) ** 2).sum(axis=2).mean(axis=0)).sum()
    assert color_change(harmonics, away) == pytest.approx(here / mean, rel=0.03)
    alike = np.tile(away[:1], (3, 1))
    assert color_change(harmonics, away[:1]) == pytest.approx(color_change(harmonics, alike))


@pytest.mark.parametrize("axis", [(0, -1, 0), (0, 0, 1), (0.6, 0, 0.8)])
def test_photos_of_one_side_are_found(axis: tuple[float, float, float]) -> None:
    to = np.array(axis) + 0.3 * CHANCE.standard_normal((40, 3))
    found = photo_direction(after_a_step(300, to, CHANCE))
    assert np.linalg.norm(found) > 0.3
    assert unit(found) @ np.array(axis) > np.cos(np.radians(10))


def test_photos_from_all_around_leave_their_height() -> None:
    turn = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn), np.full(60, 0.7)], axis=1)
    found = photo_direction(after_a_step(300, ring, CHANCE))
    assert np.linalg.norm(found) > 0.1
    assert unit(found)[2] > np.cos(np.radians(15))


def test_noise_tells_nothing() -> None:
    """As SOG's few vectors of harmonics, where each splat has the nearest."""
    noise = 0.1 * CHANCE.standard_normal((2000, 15, 3)).astype(np.float32)
    assert np.linalg.norm(photo_direction(noise)) < 0.04


@pytest.mark.parametrize("count", [0, 15])
def test_colors_that_do_not_change_tell_nothing(count: int) -> None:
    harmonics = np.zeros((9, count, 3), np.float32)
    assert color_change(harmonics, np.ones((9, 3))) == 1
    assert np.linalg.norm(photo_direction(harmonics)) < 1e-9
    assert color_change(harmonics[:0], np.ones((0, 3))) == 1
