"""gsplat's `rasterization` in plain PyTorch: what `CudaRenderer` calls where there is no GPU.

The same arguments, results and conventions: alpha is capped at 0.999, the Jacobian's clamp is
measured from the image's edges, radii know the opacity. `test_cuda` holds its projection against
gsplat's own PyTorch one where gsplat is installed; that has no blending without a GPU. No operation
here asks for a number, so that the waits of a step can be counted.
"""

from typing import Any

import torch
from torch import Tensor

from gsynopsis.render.base import ALPHA_MIN
from gsynopsis.render.reference import blend, determinant, rotations

ALPHA_MAX = 0.999
EXTENT = 3.33
"""Standard deviations beyond which nothing is drawn."""
EDGE = 0.3
"""Of half a field of view: how far outside of the image the Jacobian still follows."""


def rasterization(  # noqa: PLR0913 - gsplat's arguments
    *,
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    Ks: Tensor,
    width: int,
    height: int,
    near_plane: float,
    eps2d: float,
    packed: bool,
) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """Images [1, H, W, 3], alphas [1, H, W, 1], and `means2d` and `radii` [1, G, 2]."""
    assert not packed
    centers, conics, variances, depths = projected(
        means, covariances_of(quats, scales), viewmats[0], Ks[0], (width, height), eps2d
    )
    extent = (2 * (opacities / ALPHA_MIN).clamp(min=1).log()).sqrt().clamp(max=EXTENT)
    radii = (extent[:, None] * variances.sqrt()).ceil().int()
    size = torch.tensor([width, height])
    seen = (depths > near_plane) & (opacities >= ALPHA_MIN)
    seen = seen & ((centers + radii > 0) & (centers - radii < size)).all(dim=1)
    radii = radii * seen[:, None]
    centers = centers[None].contiguous()  # whoever differentiates it gets it as gsplat gives it
    alphas = alphas_of(centers[0], conics, opacities * seen, width, height)
    order = torch.argsort(depths, stable=True)
    weights, left = blend(alphas.index_select(0, order))
    image = weights.T @ colors.index_select(0, order)
    shape = (1, height, width, -1)
    meta = {"means2d": centers, "radii": radii[None]}
    return image.reshape(shape), (1 - left).reshape(shape), meta


def covariances_of(quats: Tensor, scales: Tensor) -> Tensor:
    """[G, 3, 3]."""
    axes = rotations(quats) * scales[:, None, :]
    return axes @ axes.transpose(1, 2)


def projected(
    means: Tensor, covariances: Tensor, w2c: Tensor, k: Tensor, size: tuple[int, int], eps2d: float
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Centres [G, 2], conics [G, 3], variances along x and y [G, 2], depths [G]."""
    points = means @ w2c[:3, :3].T + w2c[:3, 3]
    depths = points[:, 2]
    behind = depths.abs() < 1e-6
    ratios = points[:, :2] / torch.where(behind, 1, depths)[:, None]
    focal, middle = k.diagonal()[:2], k[:2, 2]
    edges = torch.tensor(size) - middle
    slack = EDGE * 0.5 * torch.tensor(size) / focal
    clamped = ratios.clamp(-(middle / focal + slack), edges / focal + slack)
    scale = focal / torch.where(behind, 1, depths)[:, None]
    jacobian = torch.cat([torch.diag_embed(scale), -(scale * clamped)[..., None]], dim=2)
    spread = jacobian @ w2c[:3, :3]
    flat = spread @ covariances @ spread.transpose(1, 2) + eps2d * torch.eye(2, dtype=means.dtype)
    area = determinant(flat).clamp(min=1e-10)
    conics = torch.stack([flat[:, 1, 1], -flat[:, 0, 1], flat[:, 0, 0]], dim=1) / area[:, None]
    variances = torch.stack([flat[:, 0, 0], flat[:, 1, 1]], dim=1)
    return ratios * focal + middle, conics, variances, depths


def alphas_of(
    centers: Tensor, conics: Tensor, opacities: Tensor, width: int, height: int
) -> Tensor:
    """Alpha of each Gaussian at each pixel centre, [G, H W], 0 below 1/255."""
    y = torch.arange(height, dtype=centers.dtype).repeat_interleave(width) + 0.5
    x = torch.arange(width, dtype=centers.dtype).repeat(height) + 0.5
    dx, dy = x - centers[:, :1], y - centers[:, 1:]
    a, b, c = (column[:, None] for column in conics.unbind(dim=1))
    sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
    alphas = (opacities[:, None] * torch.exp(-sigma)).clamp(max=ALPHA_MAX)
    return torch.where((alphas >= ALPHA_MIN) & (sigma >= 0), alphas, torch.zeros_like(alphas))
