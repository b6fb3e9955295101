"""Floaters: anchors right in front of a training camera, in what photos show as free space.

If a photo differs from the others, by its light or by a moving object, a veil before its own camera
is the cheapest way to explain it, and other views see the veil.
"""

import numpy as np
import torch
from torch import Tensor

from gsynopsis.model.anchors import AnchorModel
from gsynopsis.scene.scene import Scene

NEAREST = 0.01
"""Share of sparse points in frame that are nearer than the nearest surface is taken to be."""
NEAR = 0.1
"""An anchor nearer than this share of the nearest thing's depth is a floater (ours: where there are
none, no anchor is nearer than a quarter)."""
FEWEST_POINTS = 30
"""A camera that frames fewer points does not judge."""


def floaters(model: AnchorModel, scene: Scene) -> Tensor:
    """Mask of the anchors right in front of a training camera, bool [N].

    None if all would be.
    """
    anchors = model.placed()[0].cpu().numpy().astype(np.float64)
    found = np.zeros(len(anchors), np.bool_)
    for view in scene.train:
        camera = scene.views[view].camera
        things = camera.framed(scene.points).depths
        if len(things) >= FEWEST_POINTS:
            framed = camera.framed(anchors)
            found[framed.which] |= framed.depths < NEAR * np.quantile(things, NEAREST)
    if found.all():
        found[:] = False
    return torch.from_numpy(found).to(model.offsets.device)
