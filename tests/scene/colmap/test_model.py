"""Quaternions and rotations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsynopsis.scene.colmap.model import quaternion_from_rotation, rotation_from_quaternion

PARTS = st.tuples(*[st.floats(-1, 1) for _ in range(4)]).filter(lambda q: np.linalg.norm(q) > 1e-3)


@given(PARTS)
def test_a_rotation_survives_its_quaternion(parts):
    q = np.array(parts) / np.linalg.norm(parts)
    rotation = rotation_from_quaternion(q)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1)
    again = quaternion_from_rotation(rotation)
    assert again[0] >= 0
    np.testing.assert_allclose(rotation_from_quaternion(again), rotation, atol=1e-13)


def test_a_quarter_turn_around_z_takes_x_to_y():
    half = np.sqrt(0.5)
    turned = rotation_from_quaternion((half, 0, 0, half)) @ [1, 0, 0]
    np.testing.assert_allclose(turned, [0, 1, 0], atol=1e-15)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_half_turns_have_a_quaternion_too(axis):
    rotation = -np.eye(3)
    rotation[axis, axis] = 1
    found = np.abs(quaternion_from_rotation(rotation))
    np.testing.assert_allclose(found, np.eye(4)[axis + 1], atol=1e-15)
