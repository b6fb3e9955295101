"""The room: closed on all sides, lit, the same for the same seed."""

import numpy as np

from gsynopsis.scene.camera import Camera, look_at
from gsynopsis.synthetic.raytracer import nearest, render
from gsynopsis.synthetic.room import ORBIT, ROOM, world

UP = np.array([0.0, 0.0, 1.0])
CAMERA = Camera(24, 16, 20, 20, 12, 8, look_at(np.array([ORBIT, 0.0, 1.4]), UP * 0.9, UP))


def test_a_ray_in_any_direction_meets_something_within_the_room() -> None:
    rays = np.random.default_rng(0).standard_normal((3, 400))
    rays /= np.linalg.norm(rays, axis=0)
    origin = np.tile(np.array([[0.5], [0.4], [1.9]]), (1, 400)).astype(np.float32)
    depth, found = nearest(world(0).surfaces, origin, rays.astype(np.float32))
    assert (found >= 0).all() and (depth > 0).all()
    spot = origin + rays * depth
    for axis, most in enumerate(ROOM[:2]):
        assert np.abs(spot[axis]).max() <= most + 1e-3
    assert spot[2].min() >= -1e-3 and spot[2].max() <= ROOM[2] + 1e-3


def test_the_same_seed_paints_the_same_and_another_one_does_not() -> None:
    first = render(world(3), CAMERA)
    assert np.array_equal(first, render(world(3), CAMERA))
    assert not np.array_equal(first, render(world(4), CAMERA))
    assert 40 < first.mean() < 220 and first.std() > 20
