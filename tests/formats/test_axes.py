"""Turns take up where it should be, colours and shapes along."""

import numpy as np
import pytest
import torch

from gsynopsis.formats.axes import (
    DOWN,
    UP,
    harmonic_values,
    matrix_of,
    parse_up,
    quaternion_of,
    turn_between,
    turned,
    unit,
)
from gsynopsis.model.bake import rotations
from gsynopsis.model.harmonics import harmonic_basis, harmonic_colors
from tests.formats.scattered import scattered

AXES = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
OBLIQUE = [(0.3, -0.2, 0.9), (0.02, -0.99, 0.1), (0.01, 0.999, -0.02), (-0.5, 0.5, 0.5)]


@pytest.mark.parametrize("up", AXES + OBLIQUE)
@pytest.mark.parametrize("target", [UP, DOWN])
def test_up_goes_where_it_should_be(up: tuple[float, ...], target: tuple[float, ...]) -> None:
    start = unit(up)
    assert start
    matrix = matrix_of(turn_between(start, target))  # type: ignore[arg-type]
    assert matrix @ np.array(start) == pytest.approx(np.array(target), abs=1e-9)
    assert np.linalg.det(matrix) == pytest.approx(1)


def test_a_little_noise_in_up_turns_nothing_about_it() -> None:
    turns = [matrix_of(turn_between(unit(v), UP)) for v in ([0.01, -1, 0], [-0.01, -1, 0.01])]  # type: ignore[arg-type]
    assert np.abs(turns[0] - turns[1]).max() < 0.05


def test_shapes_and_colours_turn_along() -> None:
    given = scattered(50)
    turn = turn_between(unit([0.3, -0.2, 0.9]) or UP, UP)
    found, matrix = turned(given, turn), torch.tensor(matrix_of(turn), dtype=torch.float32)
    away = torch.tensor(given.means)
    assert torch.allclose(away @ matrix.T, torch.tensor(found.means), atol=1e-5)
    seen = harmonic_colors(torch.tensor(given.sh), away)
    again = harmonic_colors(torch.tensor(found.sh), away @ matrix.T)
    assert torch.allclose(seen, again, atol=1e-5)
    axes = matrix @ rotations(torch.tensor(given.quaternions))
    assert torch.allclose(axes, rotations(torch.tensor(found.quaternions)), atol=1e-5)


def test_harmonics_are_those_of_the_model(rng: np.random.Generator) -> None:
    d = rng.standard_normal((20, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    for count in (1, 4, 9, 16):
        assert np.allclose(harmonic_values(d, count), harmonic_basis(torch.tensor(d), count))


def test_quaternions_and_matrices_are_the_same_turns(rng: np.random.Generator) -> None:
    for _ in range(20):
        q = rng.standard_normal(4)
        matrix = matrix_of(q / np.linalg.norm(q))
        assert np.allclose(matrix_of(quaternion_of(matrix)), matrix)


@pytest.mark.parametrize(
    "text", ["", "w", "1 2", "0 0 0", "nan 0 1", "1e400 0 0", "++x", "0 0 1 0"]
)
def test_what_is_no_direction_is_none(text: str) -> None:
    assert parse_up(text) is None
