"""A scene for the browser: every level of it looks different, and plain to see."""

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.viewer.browser import SIZE
from gsynopsis.model.build import model_from_levels
from gsynopsis.records import LevelSet
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import Camera
from tests.level_sets import Shape, make_level_set

SHAPE = Shape(
    anchors=(150, 400, 900, 1800), slots=5, grids=(2, 3, 4, 4), features=4, entries=16,
    code_width=8, hidden=16,
)  # fmt: skip
LEAST_DB = 35.0
FEW = replace(SHAPE, anchors=(15, 40, 90, 180))


def bright_levels(shape: Shape = SHAPE) -> LevelSet:
    """A random level set whose Gaussians are large, opaque and colourful."""
    rng = np.random.default_rng(3)
    levels = make_level_set(rng, shape)
    levels.shared.log_scales[:, 3:] += 0.8
    for level in levels.levels:
        level.networks["opacity_b2"][:] += 0.7
        level.networks["color_b2"][:] = 2 * rng.standard_normal(3 * shape.slots)
    return levels


def camera_of(levels: LevelSet) -> Camera:
    """In front of the anchors, a little turned."""
    points = levels.shared.lattice * levels.frame.voxel
    w2c = np.eye(4)
    angle = 0.3
    w2c[:3, :3] = [[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]]
    middle = points.mean(axis=0)
    w2c[:3, 3] = -w2c[:3, :3] @ middle + [0, 0, 1.3 * np.ptp(points, axis=0).max()]
    return Camera(*SIZE, 210.0, 205.0, 118.0, 83.0, w2c)


def drawn_by_cpu(levels: LevelSet, camera: Camera) -> list[NDArray[np.float64]]:
    """What the CPU renderer draws of every level, [H, W, 3] in [0, 1]."""
    model = model_from_levels(levels)
    pictures = []
    for k in range(len(levels.levels)):
        with torch.no_grad():
            drawn = CpuRenderer().render(model.decode(camera, k), camera, torch.zeros(3)).image
        pictures.append(drawn.clamp(0, 1).numpy().astype(np.float64))
        assert pictures[-1].std() > 0.05, "the test scene shows nothing"
    return pictures
