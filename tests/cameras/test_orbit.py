"""Cameras of a flight: laws of looking, and the circle found from real cameras."""

import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from gsynopsis.cameras.orbit import (
    Circle,
    circle_of_cameras,
    circle_of_frame,
    circle_of_levels,
    circle_text,
    default_lens,
    first_camera,
    first_text,
    first_view,
    nearest_to_axes,
    orbit,
    parse_circle,
    sized,
)
from gsynopsis.records import FIRST_NOTE, ORBIT_NOTE, Frame
from gsynopsis.scene.camera import Camera, look_at
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
    levels = replace(level_set(), meta={ORBIT_NOTE: circle_text(circle)})
    found = circle_of_levels(levels)
    for name in ("target", "up", "ahead", "radius", "height"):
        assert np.allclose(getattr(found, name), getattr(circle, name), rtol=1e-6, atol=1e-6)
    assert found.arc is None and "arc" not in levels.meta[ORBIT_NOTE]


def side(degrees: Sequence[float], radius: float = 4.0) -> list[Camera]:
    """Cameras at those angles from the x axis, on a circle around the origin, looking inwards."""
    eyes = [[radius * np.cos(a), radius * np.sin(a), 1.0] for a in np.radians(degrees)]
    return [camera_at(eye, [0.0, 0.0, 0.0]) for eye in eyes]


def degrees_of(circle: Circle, turns: int) -> list[float]:
    """Where the cameras of an orbit stand, degrees from the x axis."""
    eyes = [camera.position - circle.target for camera in orbit(circle, default_lens(), turns)]
    return [float(np.degrees(np.arctan2(eye[1], eye[0]))) for eye in eyes]


def test_an_orbit_goes_back_and_forth_where_cameras_stood_on_one_side() -> None:
    circle = circle_of_cameras(side(np.arange(-10, 91, 5).tolist()))
    assert circle.arc is not None
    assert np.degrees(circle.arc) == pytest.approx([-50, 50], abs=2)
    expected = [40, 65, 90, 65, 40, 15, -10, 15]
    assert degrees_of(circle, 8) == pytest.approx(expected, abs=2)
    read = circle_of_levels(replace(level_set(), meta={ORBIT_NOTE: circle_text(circle)}))
    assert degrees_of(read, 8) == pytest.approx(expected, abs=2)


def test_the_arc_may_lie_where_angles_begin_anew() -> None:
    circle = circle_of_cameras(side(np.arange(130, 231, 10).tolist()))
    assert min(abs(a) for a in degrees_of(circle, 12)) > 129


def test_a_few_odd_cameras_decide_neither_arc_nor_circle() -> None:
    few = [*np.arange(-40.0, 41.0, 2.0), 170.0]
    circle = circle_of_cameras(side(few))
    assert circle.arc is not None
    assert max(abs(a) for a in degrees_of(circle, 12)) == pytest.approx(40, abs=1.5)
    above = camera_at([0.01, -0.01, 6.0], [0.0, 0.0, 0.0])
    assert circle_of_cameras([*side(few[:-1]), above]).arc is not None
    holed = [a for a in np.arange(0.0, 360.0, 5.0) if not 100 < a < 150]
    assert circle_of_cameras(side(holed)).arc is None


@pytest.mark.parametrize("eyes", [[30.0], [30.0, 30.0, 30.0], [0.0, 90.0, 180.0, 270.0, 45.0]])
def test_few_cameras_still_give_a_flight(eyes: list[float]) -> None:
    circle = circle_of_cameras(side(eyes))
    flight = orbit(circle, default_lens(), 5)
    assert np.isfinite([camera.w2c for camera in flight]).all()


@pytest.mark.parametrize("arc", ["[1]", "[1,0]", "[0,NaN]", "3", '["a","b"]', "null"])
def test_an_arc_that_is_none_makes_the_note_none(arc: str) -> None:
    text = '{"target":[0,0,0],"up":[0,0,1],"ahead":[1,0,0],"radius":[1],"height":[0],"arc":%s}'
    assert parse_circle(text % arc) is None
    for whole in ("[-9,9]", "[-3.1415927,3.1415927]"):
        circle = parse_circle(text % whole)
        assert circle is not None and circle.arc is None


def test_the_first_view_is_the_upright_photo_mid_arc_that_shows_the_target() -> None:
    cameras = side(np.arange(-40.0, 41.0, 10.0).tolist())
    middle = cameras[4]
    assert first_view(cameras, circle_of_cameras(cameras)) is middle
    roll = np.eye(4)
    roll[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    for worse in (
        replace(middle, w2c=roll @ middle.w2c),
        camera_at([1.0, 0.0, 0.25], [0.0, 0.0, 0.0]),
        camera_at([4.0, 0.0, 1.0], [0.0, 3.0, 0.0]),
    ):
        others = [*cameras[:4], worse, *cameras[5:]]
        found = first_view(others, circle_of_cameras(cameras))
        assert found is cameras[3] or found is cameras[5]


def test_the_note_of_the_first_view_holds_pose_and_lens() -> None:
    (camera,) = side([20.0])
    note = json.loads(first_text(replace(camera, width=80, height=40, fx=100.0, fy=50.0)))
    assert np.allclose(np.reshape(note["w2c"], (3, 4)), camera.w2c[:3], atol=1e-6)
    assert note["half"] == [0.4, 0.4]


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
    levels = replace(level_set(), meta={ORBIT_NOTE: text})
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


def test_the_first_view_comes_back_from_its_note() -> None:
    camera = ring(5, 3.0, 1.0, [0.0, 0.5, 0.0])[1]
    back = first_camera({FIRST_NOTE: first_text(camera)})
    assert back is not None and np.allclose(back.w2c, camera.w2c, atol=1e-6)
    assert (back.width, back.height) == (960, 720)
    assert back.fx / back.width == pytest.approx(camera.fx / camera.width, rel=1e-5)
    assert first_camera({}) is None and first_camera({FIRST_NOTE: "{}"}) is None
    skewed = json.dumps({"w2c": [2.0] * 12, "half": [1, 1]})
    assert first_camera({FIRST_NOTE: skewed}) is None
