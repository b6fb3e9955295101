"""Small scenes for the rasterisers, and which pixels of them are away from every cut-off."""

from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor

from gsynopsis.render.base import (
    ALPHA_MAX,
    ALPHA_MIN,
    TRANSMITTANCE_MIN,
    Gaussians,
    Renderer,
    Rendering,
)
from gsynopsis.render.reference import pixel_alphas, project
from gsynopsis.scene.camera import Camera

BACKGROUND = torch.tensor([0.1, 0.2, 0.3])
FIELDS = [field.name for field in fields(Gaussians) if field.name != "focals"]


def camera(width: int, height: int, turned: float = 0.2) -> Camera:
    """A camera near the origin that looks along +z, its principal point off the centre."""
    c, s = np.cos(turned), np.sin(turned)
    w2c = np.eye(4)
    w2c[:3, :3] = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ np.array(
        [[1, 0, 0], [0, c, s], [0, -s, c]]
    )
    w2c[:3, 3] = [0.05, -0.03, 0.1]
    focal = 0.9 * max(width, height)
    return Camera(width, height, focal, 1.05 * focal, width / 2 + 2.7, height / 2 - 1.4, w2c)


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


def random_scene(
    count: int, cam: Camera, seed: int = 0, sigma: float = 2.5, opaque: float = 0.9
) -> Gaussians:
    """Gaussians of about `sigma` pixels all over the image and a little beyond."""
    rng = np.random.default_rng(seed)
    size = np.array([cam.width, cam.height])
    depths = rng.uniform(1, 6, count)
    pixels = rng.uniform(-0.15, 1.15, (count, 2)) * size
    scales = np.exp(rng.normal(0, 0.6, (count, 3))) * (sigma * depths / cam.fx)[:, None]
    return gaussians(
        in_front_of(cam, pixels, depths),
        rng.normal(size=(count, 4)),
        scales,
        rng.uniform(0.02, opaque, count),
        rng.uniform(0, 1, (count, 3)),
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


def safe_pixels(scene: Gaussians, cam: Camera, margin: float = 1e-4) -> Tensor:
    """[H, W] bool: no alpha and no transmittance of the pixel is within `margin` (relative) of a
    value at which the image or its gradient jumps."""
    projected = project(scene, cam)
    opacities = scene.opacities[projected.index] * projected.fade
    alphas = pixel_alphas(projected, opacities, cam)
    # Recomputed without cut-offs: a scene of opacities 1 has the bare exponentials.
    raw = torch.exp(-0.5 * mahalanobis2(projected.centers, projected.covariances, cam))
    raw = raw * opacities[:, None]
    order = torch.argsort(projected.depths, stable=True)
    left = torch.cumprod(1 - alphas[order], dim=0)
    close = ((raw / ALPHA_MIN - 1).abs() < margin) | ((raw / ALPHA_MAX - 1).abs() < margin)
    close |= (left / TRANSMITTANCE_MIN - 1).abs() < 10 * margin
    return ~close.any(dim=0).reshape(cam.height, cam.width)


def mahalanobis2(centers: Tensor, covariances: Tensor, cam: Camera) -> Tensor:
    ys, xs = torch.meshgrid(
        torch.arange(cam.height, dtype=torch.float64) + 0.5,
        torch.arange(cam.width, dtype=torch.float64) + 0.5,
        indexing="ij",
    )
    offsets = torch.stack([xs.flatten(), ys.flatten()], dim=1) - centers[:, None]  # [P, H W, 2]
    return torch.einsum("npi,nij,npj->np", offsets, torch.linalg.inv(covariances), offsets)


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
