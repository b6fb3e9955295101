"""Worlds on their feet."""

import numpy as np
import pytest

from gsynopsis.capture.upright import up_of, upright
from gsynopsis.scene.camera import Camera


def looking(place: np.ndarray, target: np.ndarray, up: np.ndarray) -> Camera:
    z = (target - place) / np.linalg.norm(target - place)
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    w2c = np.eye(4)
    w2c[:3, :3] = np.stack([x, np.cross(z, x), z])
    w2c[:3, 3] = -w2c[:3, :3] @ place
    return Camera(8, 6, 5.0, 5.0, 4.0, 3.0, w2c)


def ring(target: np.ndarray, up: np.ndarray) -> list[Camera]:
    side = np.cross(up, [0.3, 0.9, -0.2])
    side /= np.linalg.norm(side)
    ahead = np.cross(up, side)
    angles = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    places = [target + 2 * (np.cos(a) * side + np.sin(a) * ahead) + 0.7 * up for a in angles]
    return [looking(place, target, up) for place in places]


def test_a_ring_of_cameras_stands_around_the_origin_with_up_along_z(rng) -> None:
    target, up = np.array([4.0, -2.0, 1.0]), np.array([0.6, 0.0, -0.8])
    cameras = ring(target, up)
    motion = upright(cameras, rng.standard_normal((5, 3)))
    assert motion[:, :3] @ motion[:, :3].T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(motion[:, :3]) == pytest.approx(1)
    assert motion[:, :3] @ target + motion[:, 3] == pytest.approx(np.zeros(3), abs=1e-9)
    heights = [(motion[:, :3] @ c.position + motion[:, 3])[2] for c in cameras]
    assert heights == pytest.approx([0.7] * 12)


def test_up_by_option_wins() -> None:
    motion = upright(ring(np.zeros(3), np.array([0.0, 0.0, 1.0])), np.zeros((1, 3)), np.eye(3)[0])
    assert motion[:, :3] @ np.eye(3)[0] == pytest.approx(np.array([0, 0, 1]), abs=1e-12)


def test_photos_taken_straight_down_on_two_courses_look_away_from_up() -> None:
    down, north = np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0])
    cameras = [
        looking(np.array([x, 0.0, 5.0]), np.array([x, 0.0, 5.0]) + down, sign * north)
        for x in range(4)
        for sign in (1.0, -1.0)
    ]
    assert up_of(cameras) == pytest.approx(-down, abs=1e-12)


def test_parallel_axes_have_the_points_in_their_middle() -> None:
    up, ahead = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
    cameras = [looking(np.array([x, 0.0, 0.0]), np.array([x, 1.0, 0.0]), up) for x in range(3)]
    points = np.array([[1.0, 5.0, 0.0], [1.0, 6.0, 0.0], [1.0, 9.0, 3.0]])
    motion = upright(cameras, points)
    assert motion[:, :3] @ np.array([1.0, 6.0, 0.0]) + motion[:, 3] == pytest.approx(np.zeros(3))
    assert motion[:, :3] @ ahead == pytest.approx(ahead, abs=1e-12)
