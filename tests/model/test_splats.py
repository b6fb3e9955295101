"""Splats as rows: what they become, of any float that a file can hold."""

import warnings

import numpy as np

from gsynopsis.model.splats import quaternions_of, rotations_of


def test_rotations_come_back_from_their_quaternions() -> None:
    quaternions = np.random.default_rng(0).standard_normal((200, 4))
    unit = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    found = quaternions_of(rotations_of(quaternions))
    same = np.abs((found * unit).sum(axis=1))
    assert np.abs(same - 1).max() < 1e-6


def test_a_rotation_too_large_to_square_is_not_finite_and_no_warning() -> None:
    rotations = np.array([[1e30, 0, 0], [0, 1e19, 3e38], [0.1, 0, 0]], np.float32)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = quaternions_of(rotations)
    assert np.isfinite(found).all(axis=1).tolist() == [False, False, True]
