"""Small seeded scenes on which two rasterizers are compared, and which of their pixels count."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from gsynopsis.render.base import ALPHA_MAX, TRANSMITTANCE_MIN, Gaussians
from gsynopsis.render.reference import pixel_alphas, project
from gsynopsis.scene.camera import Camera

MARGIN = 1e-3
"""Relative distance of an alpha from its cut-off within which rounding may decide."""
OPAQUE = 0.95
"""Largest opacity: below the cap of every backend (0.99 here, 0.999 in gsplat)."""


@dataclass(frozen=True)
class Case:
    """A scene in float64 that holds float32 values, and the camera that looks at it."""

    name: str
    gaussians: Gaussians
    camera: Camera


def cases() -> list[Case]:
    """Sizes that are not multiples of a tile, dense and sparse scenes, hidden Gaussians."""
    wide, odd = make_camera(80, 60), make_camera(67, 45)
    column, big = make_camera(1, 70), make_camera(160, 107)
    away = Camera(80, 60, wide.fx, wide.fy, wide.cx, wide.cy, np.diag([1.0, -1, -1, 1]) @ wide.w2c)
    return [
        Case("plain", random_gaussians(200, wide, 1, 2.5), wide),
        Case("dense", random_gaussians(300, wide, 2, 8), wide),
        Case("tiny", random_gaussians(400, wide, 3, 0.2), wide),
        Case("large", random_gaussians(40, wide, 4, 60), wide),
        Case("odd", random_gaussians(200, odd, 5, 2.5), odd),
        Case("column", random_gaussians(60, column, 6, 2.5), column),
        Case("many", random_gaussians(600, big, 8, 2.5), big),
        Case("smaller", replace(random_gaussians(200, wide, 9, 0.5), focals=(300.0, 400.0)), wide),
        Case("unseen", random_gaussians(50, wide, 7, 2.5), away),
        Case("none", random_gaussians(0, wide, 0, 2.5), wide),
    ]


def make_camera(width: int, height: int) -> Camera:
    """A turned camera whose principal point is off the centre by up to 2 % of the image.

    No more than that: gsplat measures the clamp of the Jacobian from the image's edges.
    """
    c, s = np.cos(0.2), np.sin(0.2)
    w2c = np.eye(4)
    w2c[:3, :3] = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ [[1, 0, 0], [0, c, s], [0, -s, c]]
    w2c[:3, 3] = [0.05, -0.03, 0.1]
    focal = 0.9 * max(width, height)
    return Camera(width, height, focal, 1.05 * focal, 0.52 * width, 0.49 * height, w2c)


def random_gaussians(
    count: int, camera: Camera, seed: int = 0, sigma: float = 2.5, opaque: float = OPAQUE
) -> Gaussians:
    """Gaussians of about `sigma` pixels all over the image and a tenth beyond.

    Values are as float32 has them, kept in float64, so that every backend gets the same.
    """
    rng = np.random.default_rng(seed)
    depths = rng.uniform(1, 6, count)
    pixels = rng.uniform(-0.1, 1.1, (count, 2)) * [camera.width, camera.height]
    x = (pixels[:, 0] - camera.cx) / camera.fx * depths
    y = (pixels[:, 1] - camera.cy) / camera.fy * depths
    points = np.stack([x, y, depths], axis=1)
    arrays = (
        (points - camera.w2c[:3, 3]) @ camera.w2c[:3, :3],
        rng.normal(size=(count, 4)),
        np.exp(rng.normal(0, 0.6, (count, 3))) * (sigma * depths / camera.fx)[:, None],
        rng.uniform(0.02, opaque, count),
        rng.uniform(0, 1, (count, 3)),
    )
    return Gaussians(*(torch.from_numpy(a.astype(np.float32).astype(np.float64)) for a in arrays))


def safe_pixels(gaussians: Gaussians, camera: Camera, margin: float = MARGIN) -> Tensor:
    """[H, W] bool: no Gaussian is so near a cut-off in the pixel that rounding decides about it.

    A cut-off is near if opacities a little lower or higher change which Gaussians are drawn in the
    pixel or which of them have the largest alpha; or if the light that passes is near the least.
    """
    projected = project(gaussians, camera)
    opacities = gaussians.opacities[projected.index] * projected.fade
    lower, alphas, higher = (
        pixel_alphas(projected, opacities * factor, camera)  # [P, H W]
        for factor in (1 - margin, 1, 1 + margin)
    )
    order = torch.argsort(projected.depths, stable=True)
    left = torch.cumprod(1 - alphas[order], dim=0)
    close = ((lower > 0) != (higher > 0)) | ((lower < ALPHA_MAX) & (higher >= ALPHA_MAX))
    close |= (left / TRANSMITTANCE_MIN - 1).abs() < 10 * margin
    return ~close.any(dim=0).reshape(camera.height, camera.width)
