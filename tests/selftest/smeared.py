"""A renderer that is a little wrong."""

from dataclasses import replace

import torch

from gsynopsis.render.base import Gaussians, Rendering
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import Camera


class Smeared:
    """Wrong by a tenth of a pixel, and blind for the first Gaussian."""

    name, device = "smeared", torch.device("cpu")

    def render(self, gaussians: Gaussians, camera: Camera, background: torch.Tensor) -> Rendering:
        drawn = CpuRenderer().render(gaussians, replace(camera, cx=camera.cx + 0.1), background)
        visible = drawn.visible.clone()
        visible[:1] = False
        return replace(drawn, visible=visible)
