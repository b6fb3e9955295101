"""The oracle: plain PyTorch, every Gaussian at every pixel, in any float dtype."""

from dataclasses import dataclass

import torch
from torch import Tensor

from gsynopsis.render.base import (
    ALPHA_MAX,
    ALPHA_MIN,
    FOV_CLAMP,
    NEAR_PLANE,
    TRANSMITTANCE_MIN,
    Gaussians,
    Rendering,
    low_pass_filter,
)
from gsynopsis.scene.camera import Camera


@dataclass(frozen=True)
class Projected:
    """The P Gaussians that can be drawn, on the image plane."""

    index: Tensor  # [P] which of the G Gaussians
    centers: Tensor  # [P, 2] pixels
    covariances: Tensor  # [P, 2, 2] px², dilated
    depths: Tensor  # [P] world units along the camera's z
    fade: Tensor  # [P] factor on opacity, at most 1


class ReferenceRenderer:
    """Rasterises in plain PyTorch: slow, differentiable by autograd, made to be read.

    Computes in the dtype and on the device of the Gaussians. Memory grows with G × H × W.
    """

    name = "reference"

    def __init__(self, device: torch.device | str = "cpu") -> None:
        self.device = torch.device(device)

    def render(self, gaussians: Gaussians, camera: Camera, background: Tensor) -> Rendering:
        """Rasterise; see `Renderer.render`."""
        projected = project(gaussians, camera)
        centers = projected.centers
        if centers.requires_grad:
            centers.retain_grad()
        opacities = gaussians.opacities[projected.index] * projected.fade
        alphas = pixel_alphas(projected, opacities, camera)  # [P, H W]
        visible = torch.zeros(len(gaussians), dtype=torch.bool, device=alphas.device)
        visible[projected.index] = (alphas > 0).any(dim=1)

        order = torch.argsort(projected.depths, stable=True)
        colors = gaussians.colors[projected.index][order]
        weights, transmittance = blend(alphas[order])
        image = weights.T @ colors + transmittance[:, None] * background.to(colors)
        shape = (camera.height, camera.width)

        def screen_grad() -> Tensor:
            grad = torch.zeros_like(gaussians.means[:, :2])
            if centers.grad is not None:
                grad[projected.index] = centers.grad
            return grad

        alpha = 1 - transmittance.detach().reshape(shape)
        return Rendering(image.reshape(*shape, 3), alpha, visible, screen_grad)


def project(gaussians: Gaussians, camera: Camera) -> Projected:
    """EWA projection of the Gaussians that are finite and in front of the near plane."""
    w2c = torch.as_tensor(camera.w2c).to(gaussians.means)
    with torch.no_grad():
        in_front = gaussians.means @ w2c[2, :3] + w2c[2, 3] >= NEAR_PLANE
    index = torch.nonzero(drawable(gaussians) & in_front).flatten()
    points = gaussians.means[index] @ w2c[:3, :3].T + w2c[:3, 3]  # [P, 3]
    depths = points[:, 2]
    ratios = points[:, :2] / depths[:, None]
    focal = ratios.new_tensor([camera.fx, camera.fy])
    principal = ratios.new_tensor([camera.cx, camera.cy])
    forms = gaussians.quats[index], gaussians.scales[index]
    covariances, fade = blurred(
        points, *forms, camera, low_pass_filter(gaussians.focals, camera.focal_length)
    )
    return Projected(index, focal * ratios + principal, covariances, depths, fade)


def blurred(
    points: Tensor, quats: Tensor, scales: Tensor, camera: Camera, added: tuple[float, float]
) -> tuple[Tensor, Tensor]:
    """Projected covariances [P, 2, 2], px², with all of their dilation, and factors on opacity [P].

    Args:
        points: Centres in the camera's space, [P, 3], none at depth 0.
        quats: [P, 4], of any length but 0.
        scales: [P, 3].
        camera: Any pinhole camera.
        added: Dilations, of the Gaussians' own and all; see `low_pass_filter`.
    """
    turn = torch.as_tensor(camera.w2c).to(points)[:3, :3]
    spread = jacobians(points, camera) @ turn @ (rotations(quats) * scales[:, None, :])  # [P, 2, 3]
    bare = spread @ spread.transpose(1, 2)
    unit = torch.eye(2, dtype=spread.dtype, device=spread.device)
    own, covariances = (bare + dilation * unit for dilation in added)
    # Of long thin ones rounding may leave less than nothing.
    return covariances, (determinant(own) / determinant(covariances)).clamp(min=0).sqrt()


def jacobians(points: Tensor, camera: Camera) -> Tensor:
    """Derivatives [P, 2, 3] of pixels with respect to points [P, 3] of the camera's space."""
    depths = points[:, 2:]
    focal = points.new_tensor([camera.fx, camera.fy])
    limits = FOV_CLAMP * 0.5 * points.new_tensor([camera.width, camera.height]) / focal
    clamped = (points[:, :2] / depths).clamp(-limits, limits)
    scale = focal / depths  # [P, 2]
    return torch.cat([torch.diag_embed(scale), -(scale * clamped)[..., None]], dim=2)


def determinant(matrices: Tensor) -> Tensor:
    """Determinants [P] of matrices [P, 2, 2]."""
    return matrices[:, 0, 0] * matrices[:, 1, 1] - matrices[:, 0, 1] * matrices[:, 1, 0]


def drawable(gaussians: Gaussians) -> Tensor:
    """Mask of the Gaussians that are finite, turned and opaque enough to be drawn, bool [G]."""
    with torch.no_grad():
        good = torch.isfinite(gaussians.opacities) & (gaussians.opacities >= ALPHA_MIN)
        for field in (gaussians.means, gaussians.quats, gaussians.scales, gaussians.colors):
            good = good & torch.isfinite(field).all(dim=1)
        return good & (gaussians.quats.norm(dim=1) > 0)


def rotations(quats: Tensor) -> Tensor:
    """Rotation matrices [P, 3, 3] of quaternions [P, 4] (w, x, y, z) of any length."""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=1).unbind(dim=1)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], dim=1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], dim=1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], dim=1),
    ]
    return torch.stack(rows, dim=1)


def pixel_alphas(projected: Projected, opacities: Tensor, camera: Camera) -> Tensor:
    """Alpha of each Gaussian at each pixel centre, [P, H W], 0 below 1/255."""
    like = projected.centers
    ys, xs = torch.meshgrid(
        torch.arange(camera.height, dtype=like.dtype, device=like.device) + 0.5,
        torch.arange(camera.width, dtype=like.dtype, device=like.device) + 0.5,
        indexing="ij",
    )
    dx = xs.reshape(1, -1) - projected.centers[:, :1]
    dy = ys.reshape(1, -1) - projected.centers[:, 1:]
    xx, xy, yy = (projected.covariances[:, i, j, None] for i, j in ((0, 0), (0, 1), (1, 1)))
    areas2 = determinant(projected.covariances)[:, None]
    mahalanobis2 = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / areas2
    alphas = (opacities[:, None] * torch.exp(-0.5 * mahalanobis2)).clamp(max=ALPHA_MAX)
    return torch.where(alphas >= ALPHA_MIN, alphas, torch.zeros_like(alphas))


def blend(alphas: Tensor) -> tuple[Tensor, Tensor]:
    """Blend weights [P, H W] and remaining transmittance [H W] of alphas [P, H W] front to back."""
    with torch.no_grad():
        goes_on = torch.cumprod(1 - alphas, dim=0) >= TRANSMITTANCE_MIN
    alphas = torch.where(goes_on, alphas, torch.zeros_like(alphas))
    ones = torch.ones_like(alphas[:1]) if len(alphas) else alphas.new_ones(1, alphas.shape[1])
    transmittance = torch.cat([ones, torch.cumprod(1 - alphas, dim=0)])  # [P + 1, H W]
    return alphas * transmittance[:-1], transmittance[-1]
