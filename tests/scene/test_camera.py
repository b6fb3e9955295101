"""Cameras: sizes, shifts, and rotations made of directions."""

import numpy as np
import pytest

from gsynopsis.scene.camera import (
    Camera,
    across,
    look_at,
    look_from,
    nearest_rotation,
    scaled_size,
    unit,
    world_to_camera,
)

EYE = np.array([3.0, -2.0, 1.5])
CAMERA = Camera(96, 64, fx=80.0, fy=90.0, cx=40.0, cy=33.0, w2c=look_at(EYE, np.zeros(3), EYE))


def test_a_camera_that_looks_at_a_point_has_it_in_its_middle_and_up_above() -> None:
    up = np.array([0.0, 0.0, 1.0])
    w2c = look_at(EYE, np.zeros(3), up)
    x, y, z = w2c[:3, 3]  # the origin
    assert (x, y) == pytest.approx((0, 0), abs=1e-12) and z == pytest.approx(np.linalg.norm(EYE))
    above = w2c[:3, :3] @ up
    assert above[0] == pytest.approx(0, abs=1e-12) and above[1] < 0  # y points down
    assert np.allclose(w2c[:3, :3] @ w2c[:3, :3].T, np.eye(3))


def test_up_along_the_view_is_no_reason_to_fail() -> None:
    assert np.allclose(CAMERA.position, EYE) and np.allclose(CAMERA.forward, -unit(EYE))
    assert np.isfinite(CAMERA.w2c).all()


def test_many_eyes_look_as_each_alone() -> None:
    eyes, up = np.stack([EYE, -EYE, EYE[::-1]]), np.array([0.0, 1.0, 0.0])
    together = look_from(eyes, np.ones(3), up)
    assert all(
        np.allclose(one, look_at(eye, np.ones(3), up))
        for one, eye in zip(together, eyes, strict=True)
    )


def test_points_in_frame_are_before_the_camera_and_within_the_image() -> None:
    camera = Camera(10, 8, fx=10, fy=10, cx=5, cy=4, w2c=np.eye(4))
    points = np.array([[0, 0, 2], [0, 0, -2], [0.99, 0, 2], [1.01, 0, 2], [0, -0.81, 2], [0, 0, 0]])
    found = camera.framed(points)
    assert found.which.tolist() == [True, False, True, False, False, False]
    assert found.columns.tolist() == [5, 9] and found.rows.tolist() == [4, 4]
    assert found.depths.tolist() == [2, 2]


def test_a_scaled_camera_shows_a_point_at_the_scaled_pixel() -> None:
    half = CAMERA.scaled(2)
    assert (half.width, half.height) == (48, 32)
    assert (half.fx, half.fy, half.cx, half.cy) == (40, 45, 20, 16.5)
    assert half.focal_length == pytest.approx(CAMERA.focal_length / 2)
    assert scaled_size(5, 3, 2) == (2, 2) and scaled_size(3, 1, 100) == (1, 1)


def test_a_shift_moves_pixels_and_so_the_principal_point_the_other_way() -> None:
    shifted = CAMERA.shifted((0.25, -0.5))
    assert (shifted.cx, shifted.cy) == (39.75, 33.5) and shifted.fx == CAMERA.fx


def test_the_nearest_rotation_mends_a_little_and_refuses_much_and_mirrors() -> None:
    rotation = CAMERA.w2c[:3, :3]
    found, off = nearest_rotation(rotation * 1.0001, 1e-3)
    assert found is not None and np.allclose(found, rotation) and off == pytest.approx(2e-4, 1e-2)
    assert nearest_rotation(rotation * 1.1, 1e-3)[0] is None
    assert nearest_rotation(np.diag([1.0, 1.0, -1.0]), 1e-3)[0] is None


def test_world_to_camera_is_the_inverse_of_the_camera_in_the_world() -> None:
    found = world_to_camera(CAMERA.w2c[:3, :3].T, EYE)
    assert np.allclose(found, CAMERA.w2c)


def test_what_is_across_is_at_right_angles_even_of_nothing() -> None:
    axes = unit(np.array([[0.0, 0.0, 2.0], [1.0, 1.0, 0.0]]))
    found = across(np.array([[1.0, 0.0, 5.0], [2.0, 2.0, 0.0]]), axes)
    assert np.allclose((found * axes).sum(axis=1), 0)
    assert np.allclose(np.linalg.norm(found, axis=1), 1)
    assert np.allclose(found[0], [1, 0, 0])
