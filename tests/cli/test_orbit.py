"""Cameras of a flight: laws of looking, and the circle found from real cameras."""

from dataclasses import replace

import numpy as np
import pytest

from gsynopsis.cli.orbit import (
    META,
    circle_of_cameras,
    circle_of_frame,
    circle_of_levels,
    circle_text,
    default_lens,
    look_at,
    nearest_to_axes,
    orbit,
    parse_circle,
    sized,
)
from gsynopsis.records import Frame
from gsynopsis.scene.camera import Camera
from tests.stage import level_set

UP = np.array([0.0, 0.0, 1.0])


def camera_at(eye: list[float], target: list[float]) -> Camera:
    w2c = look_at(np.array(eye), np.array(target), UP)
    return Camera(80, 60, 90.0, 90.0, 40.0, 30.0, w2c)


def ring(count: int, radius: float, height: float, center: list[float]) -> list[Camera]:
    middle = np.array(center)
    angles = np.linspace(0.3, 2 * np.pi + 0.3, count, endpoint=False)
    eyes = [middle + np.array([radius * np.cos(a), radius * np.sin(a), height]) for a in angles]
    return [camera_at(eye.tolist(), center) for eye in eyes]


def test_looking_is_a_rotation_that_keeps_up_up() -> None:
    eye, target = np.array([3.0, 1.0, 2.0]), np.array([0.0, 0.5, 0.0])
    camera = Camera(80, 60, 90.0, 90.0, 40.0, 30.0, look_at(eye, target, UP))
    rotation = camera.w2c[:3, :3]
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert np.allclose(camera.position, eye)
    assert np.allclose(camera.forward, (target - eye) / np.linalg.norm(target - eye))
    assert rotation[1] @ UP < 0  # image y points down


def test_looking_straight_down_is_still_a_rotation() -> None:
    rotation = look_at(np.array([0.0, 0.0, 5.0]), np.zeros(3), UP)[:3, :3]
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)


def test_the_circle_of_a_ring_of_cameras_is_that_ring() -> None:
    circle = circle_of_cameras(ring(12, 4.0, 1.5, [7.0, -2.0, 0.5]))
    assert np.allclose(circle.target, [7.0, -2.0, 0.5], atol=0.01)
    assert circle.radius == pytest.approx(4.0, rel=0.01)
    assert circle.height == pytest.approx(1.5, rel=0.01)
    assert np.allclose(circle.up, UP, atol=1e-6)


def test_an_orbit_starts_near_the_first_camera_and_looks_at_the_target() -> None:
    cameras = ring(12, 4.0, 1.5, [7.0, -2.0, 0.5])
    circle = circle_of_cameras(cameras)
    flight = orbit(circle, cameras[0], 8)
    assert np.allclose(flight[0].position, cameras[0].position, atol=0.05)
    for camera in flight:
        pixel = camera.w2c[:3, :3] @ circle.target + camera.w2c[:3, 3]
        assert np.allclose(pixel[:2], 0.0, atol=1e-9)
        assert pixel[2] > 0
        assert np.linalg.norm(camera.position - circle.target) == pytest.approx(
            np.hypot(circle.radius, circle.height)
        )
    assert len({tuple(np.round(c.position, 6)) for c in flight}) == 8


@pytest.mark.parametrize("outwards", [False, True])
def test_cameras_without_a_common_point_still_give_a_target_ahead(outwards: bool) -> None:
    eyes = [[0.1 * x, 0.0, 0.0] for x in range(6)]
    aims = [[0.1 * x, 9.0, 0.0] for x in range(6)]
    if outwards:
        aims = [[3.0 * (x - 2.5), 9.0, 0.0] for x in range(6)]
    cameras = [camera_at(e, a) for e, a in zip(eyes, aims, strict=True)]
    circle = circle_of_cameras(cameras)
    assert circle.target[1] > 0.1
    assert circle.radius > 0


def test_the_nearest_point_to_crossing_axes_is_their_crossing() -> None:
    target = np.array([1.0, 2.0, 3.0])
    eyes = np.array([[5.0, 2.0, 3.0], [1.0, -4.0, 3.0], [1.0, 2.0, 9.0]])
    forwards = (target - eyes) / np.linalg.norm(target - eyes, axis=1)[:, None]
    assert np.allclose(nearest_to_axes(eyes, forwards), target, atol=0.02)


def test_a_file_carries_the_circle_of_its_cameras() -> None:
    circle = circle_of_cameras(ring(9, 4.0, 1.5, [7.0, -2.0, 0.5]))
    levels = replace(level_set(), meta={META: circle_text(circle)})
    found = circle_of_levels(levels)
    for name in ("target", "up", "ahead", "radius", "height"):
        assert np.allclose(getattr(found, name), getattr(circle, name), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    "text",
    [
        *("", "1", "{}", "[" * 100_000, '{"target":1}', "null"),
        '{"target":[0,0,0],"up":[0,0,0],"ahead":[1,0,0],"radius":[1],"height":[0]}',
        '{"target":[0,0,NaN],"up":[0,0,1],"ahead":[1,0,0],"radius":[1],"height":[0]}',
        '{"target":[0,0,0],"up":[0,0,1],"ahead":[1,0,0],"radius":[-1],"height":[0]}',
        '{"target":[0,0,0],"up":[0,0,1],"ahead":[1,0],"radius":[1],"height":[0]}',
        '{"target":[0,0,0],"up":[0,0,1],"ahead":[1,0,0],"radius":1,"height":[0]}',
    ],
)
def test_a_circle_that_cannot_be_flown_gives_way_to_the_frame_s(text: str) -> None:
    levels = replace(level_set(), meta={META: text})
    assert parse_circle(text) is None
    assert np.allclose(circle_of_levels(levels).target, levels.frame.center)


def test_an_ahead_along_up_is_put_across() -> None:
    text = '{"target":[0,0,0],"up":[0,0,2],"ahead":[0,0,1],"radius":[1],"height":[0]}'
    circle = parse_circle(text)
    assert circle is not None
    assert np.allclose(circle.up, UP)
    assert circle.ahead @ circle.up == pytest.approx(0.0)


def test_without_a_scene_the_circle_is_the_frame_s() -> None:
    frame = Frame(0.01, np.array([1.0, 2.0, 3.0]), 2.0, True, 5.5)
    circle = circle_of_frame(frame)
    assert np.allclose(circle.target, frame.center)
    assert np.hypot(circle.radius, circle.height) == pytest.approx(5.0)
    first = orbit(circle, default_lens(), 4)[0]
    assert np.allclose(first.w2c[:3, :3] @ frame.center + first.w2c[:3, 3], [0, 0, 5.0])


def test_pictures_of_another_size_keep_the_middle_and_the_height_of_the_view() -> None:
    lens = Camera(100, 50, 80.0, 80.0, 50.0, 25.0, np.eye(4))
    double = sized(lens, 200, None)
    assert (double.width, double.height, double.fx) == (200, 100, 160.0)
    wide = sized(lens, 300, 50)
    assert (wide.width, wide.height, wide.fx, wide.cx) == (300, 50, 80.0, 150.0)
    assert sized(lens, None, 25).width == 50
    assert sized(lens, None, None) is lens
