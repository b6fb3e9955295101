"""Small scenes for the rasterisers, and which pixels of them are away from every cut-off."""

from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor

from gsynopsis.render.base import Gaussians, Renderer, Rendering
from gsynopsis.scene.camera import Camera
from gsynopsis.selftest import raster_cases

camera, random_scene = raster_cases.make_camera, raster_cases.random_gaussians
BACKGROUND = torch.tensor([0.1, 0.2, 0.3])
MARGIN = 1e-4
"""Relative distance from a value at which the image or its gradient jumps."""
FIELDS = [field.name for field in fields(Gaussians) if field.name != "focals"]


def in_front_of(cam: Camera, pixels: np.ndarray, depths: np.ndarray) -> np.ndarray:
    """World points [G, 3] seen at these pixels [G, 2] in these depths [G]."""
    x = (pixels[:, 0] - cam.cx) / cam.fx * depths
    y = (pixels[:, 1] - cam.cy) / cam.fy * depths
    points = np.stack([x, y, depths], axis=1)
    return (points - cam.w2c[:3, 3]) @ cam.w2c[:3, :3]


def gaussians(
    means: np.ndarray, quats: np.ndarray, scales: np.ndarray, opacities: np.ndarray, colors: object
) -> Gaussians:
    """Values as float32 has them, kept in float64, so that every backend gets the same."""
    return Gaussians(
        *(
            torch.tensor(np.asarray(values, np.float32), dtype=torch.float64)
            for values in (means, quats, scales, opacities, colors)
        )
    )


def hand_scene(cam: Camera) -> Gaussians:
    """Eleven Gaussians: round, long and thin ones over a tile's border, one capped, a stack."""
    pixels = [[12, 10], [31, 14], [33, 20], [40, 8], [20, 24], [22, 25], *[[46.3, 27.2]] * 5]
    depths = [2.0, 1.5, 2.5, 3.0, 1.2, 4.0, 1.0, 1.1, 1.3, 1.7, 2.2]
    sigmas = [[3, 3, 3], [9, 1, 2], [1, 6, 1], [2, 2, 4], [5, 4, 3], [8, 8, 8], *[[4, 5, 4]] * 5]
    quats = [[1, 0, 0, 0], [2, 0.3, 0.1, 0.9], [0.7, 0.1, -0.4, 0.2], [0.5, 0.5, 0.5, 0.4]]
    depth = np.array(depths)
    return gaussians(
        in_front_of(cam, np.array(pixels), depth),
        np.array([quats[i % 4] for i in range(11)]),
        np.array(sigmas) * (depth / cam.fx)[:, None],
        np.array([0.9, 0.6, 0.7, 0.5, 1.0, 0.8, 0.95, 0.93, 0.96, 0.97, 0.98]),
        np.random.default_rng(0).uniform(0, 1, (11, 3)),
    )


def safe_pixels(scene: Gaussians, cam: Camera) -> Tensor:
    """[H, W] bool: no alpha and no transmittance of the pixel is near a cut-off."""
    return raster_cases.safe_pixels(scene, cam, MARGIN)


@dataclass(frozen=True)
class ViewResult:
    """An image, what came with it, and the gradients of one loss."""

    rendering: Rendering
    image: Tensor
    grads: dict[str, Tensor]
    screen: Tensor


def loss_weights(scene: Gaussians, cam: Camera, seed: int = 1) -> Tensor:
    """Random weights [H, W, 3] float64, zero where a cut-off is near."""
    rng = np.random.default_rng(seed)
    weights = torch.tensor(rng.normal(size=(cam.height, cam.width, 3)))
    return weights * safe_pixels(scene, cam)[..., None]


def run(
    renderer: Renderer,
    scene: Gaussians,
    cam: Camera,
    weights: Tensor,
    dtype: torch.dtype = torch.float32,
) -> ViewResult:
    """Renders and differentiates the weighted sum of the image."""
    leaves = [getattr(scene, name).to(dtype, copy=True).requires_grad_(True) for name in FIELDS]
    background = BACKGROUND.to(dtype, copy=True).requires_grad_(True)
    rendering = renderer.render(Gaussians(*leaves, focals=scene.focals), cam, background)
    (rendering.image * weights.to(rendering.image.dtype)).sum().backward()
    grads = dict(zip([*FIELDS, "background"], [t.grad for t in [*leaves, background]], strict=True))
    return ViewResult(rendering, rendering.image.detach(), grads, rendering.screen_grad())
