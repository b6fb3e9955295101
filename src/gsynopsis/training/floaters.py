"""Floaters: anchors right in front of a training camera, where no photo shows a thing.

Where a photo differs from the others, by its light or by what moved, a veil before its own lens is
the cheapest way to explain it, and other views see the veil.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gsynopsis.model.anchors import AnchorModel
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.scene import Scene

NEAREST = 0.01
"""Share of the sparse points in frame that are nearer than what counts as the nearest thing."""
NEAR = 0.1
"""An anchor nearer than this share of the nearest thing's depth is a floater (ours: where there are
none, no anchor is nearer than a quarter)."""
FEWEST_POINTS = 30
"""A camera that frames fewer points does not judge."""


def floaters(model: AnchorModel, scene: Scene) -> Tensor:
    """Which anchors stand right in front of a training camera, bool [N].

    None does where all would.
    """
    anchors = model.placed()[0].cpu().numpy().astype(np.float64)
    found = np.zeros(len(anchors), np.bool_)
    for view in scene.train:
        camera = scene.views[view].camera
        depths = _framed_depths(camera, scene.points)
        things = depths[np.isfinite(depths)]
        if len(things) >= FEWEST_POINTS:
            found |= _framed_depths(camera, anchors) < NEAR * np.quantile(things, NEAREST)
    if found.all():
        found[:] = False
    return torch.from_numpy(found).to(model.offsets.device)


def _framed_depths(camera: Camera, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Depth of points [P, 3] where a camera has them in frame, infinite elsewhere, [P]."""
    local = points @ camera.w2c[:3, :3].T + camera.w2c[:3, 3]
    ahead = local[:, 2] > 0
    depth = np.where(ahead, local[:, 2], 1.0)
    x = camera.fx * local[:, 0] / depth + camera.cx
    y = camera.fy * local[:, 1] / depth + camera.cy
    framed = ahead & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
    return np.where(framed, depth, np.inf)
