"""A sparse model small enough to be cut off at every byte."""

from collections.abc import Sequence

import numpy as np

from gsynopsis.scene.colmap.model import Pinhole, Pose, SparseModel

SIZE = (12, 10)


def tiny_model(names: Sequence[str], points: int = 7) -> SparseModel:
    rng = np.random.default_rng(3)
    poses: list[Pose] = []
    for number, name in enumerate(names):
        angle = 0.1 * number
        quaternion = (float(np.cos(angle)), 0.0, float(np.sin(angle)), 0.0)
        poses.append(Pose(name, 1, quaternion, (0.3 * number, -0.1, 2.0)))
    lens = {1: Pinhole(*SIZE, 11.0, 10.5, 5.5, 5.25)}
    colors = rng.integers(0, 256, (points, 3)).astype(np.uint8)
    return SparseModel(lens, tuple(poses), rng.standard_normal((points, 3)), colors)
