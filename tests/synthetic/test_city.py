"""The city: blocks in a grid, a flight over them, houses where blocks are."""

import numpy as np
import pytest

from gsynopsis.synthetic.city import PITCH, STREET, block_centers, flight, grid_of, world
from gsynopsis.synthetic.raytracer import nearest


@pytest.mark.parametrize("views", [4, 40, 300, 2000])
def test_a_block_for_about_ten_photos_in_more_columns_than_rows(views: int) -> None:
    across, along = grid_of(views)
    assert across >= along >= 2
    if views > 40:
        assert views / 10 == pytest.approx(across * along, rel=0.3)


def test_blocks_are_a_pitch_apart_around_the_origin() -> None:
    centers = np.array(block_centers((3, 2)))
    assert len(centers) == 6 and np.allclose(centers.mean(axis=0), 0)
    assert centers[:3, 0].tolist() == [-PITCH, 0, PITCH] and len(set(centers[:3, 1])) == 1


def test_a_flight_has_a_place_and_a_target_for_each_photo_and_repeats() -> None:
    places = flight(24, (3, 2), 1)
    assert len(places) == 24
    eyes = np.array([eye for eye, _ in places])
    targets = np.array([target for _, target in places])
    assert (eyes[:, 2] > 1).all() and (np.linalg.norm(eyes - targets, axis=1) > 1).all()
    assert np.abs(eyes[:, :2]).max() < 3 * PITCH
    again = flight(24, (3, 2), 1)
    assert all(np.array_equal(a, b) for a, b in zip(eyes, [e for e, _ in again], strict=True))


def test_houses_stand_on_blocks_and_streets_are_free() -> None:
    city = world(0, (2, 2))
    middle = np.arange(-PITCH / 2 + STREET / 2 + 0.5, PITCH / 2 - STREET / 2, 0.5)
    lots = [(x + a, y + b) for x, y in block_centers((2, 2)) for a in middle for b in middle]
    streets = [(0.0, float(y)) for y in np.linspace(-0.9 * PITCH, 0.9 * PITCH, 40)]

    def heights(places: list[tuple[float, float]]) -> np.ndarray:
        xy = np.array(places, np.float32).T
        origin = np.vstack([xy, np.full((1, xy.shape[1]), 100, np.float32)])
        down = np.tile(np.array([[0], [0], [-1]], np.float32), (1, xy.shape[1]))
        return 100 - nearest(city.surfaces, origin, down)[0]

    assert heights(streets).max() < 1.0
    assert (heights(lots) > 3).mean() > 0.1
