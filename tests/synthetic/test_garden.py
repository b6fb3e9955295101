"""The garden: ground below, sky above and far away, the same for the same seed."""

import numpy as np

from gsynopsis.scene.camera import Camera, look_at
from gsynopsis.synthetic.garden import ORBIT, world
from gsynopsis.synthetic.raytracer import nearest, render

UP = np.array([0.0, 0.0, 1.0])
CAMERA = Camera(24, 16, 20, 20, 12, 8, look_at(np.array([ORBIT, 0.0, 1.5]), UP * 0.5, UP))


def depths(direction: tuple[float, float, float]) -> float:
    ray = np.array(direction, np.float32)[:, None] / np.float32(np.linalg.norm(direction))
    origin = np.array([[ORBIT], [0.0], [1.5]], np.float32)
    return float(nearest(world(0).surfaces, origin, ray)[0][0])


def test_the_ground_is_below_and_the_sky_is_110_orbits_away() -> None:
    assert abs(depths((0, 0, -1)) - 1.5) < 0.3
    assert 100 * ORBIT < depths((0, 0, 1)) < 120 * ORBIT


def test_away_from_the_house_there_are_hills_behind_the_garden() -> None:
    assert 20 * ORBIT < depths((1, 0.3, 0.05)) < 70 * ORBIT


def test_the_same_seed_paints_the_same_and_another_one_does_not() -> None:
    first = render(world(3), CAMERA)
    assert np.array_equal(first, render(world(3), CAMERA))
    assert not np.array_equal(first, render(world(4), CAMERA))
