"""The CUDA rasteriser: gsplat behind the renderer protocol, imported when first used.

Differences of gsplat from the other two backends, which no option removes: alpha is capped at 0.999
instead of 0.99; for a principal point off the image's centre the clamp of x/z and y/z in the
Jacobian is measured from the image's edges; sums are in no fixed order, so the last bits change
from run to run.
"""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from gsynopsis.errors import MissingExtraError
from gsynopsis.render.base import NEAR_PLANE, Gaussians, Rendering, low_pass_filter, sent
from gsynopsis.render.reference import blurred, drawable
from gsynopsis.scene.camera import Camera


class CudaRenderer:
    """Rasterises on a CUDA device with gsplat, in float32."""

    name = "cuda"

    def __init__(self, device: torch.device | str = "cuda") -> None:
        """Imports gsplat; `MissingExtraError` if it or a CUDA device is not there."""
        self.device = torch.device(device)
        self._rasterization = _import_gsplat()

    def render(self, gaussians: Gaussians, camera: Camera, background: Tensor) -> Rendering:
        """Rasterise; see `Renderer.render`."""
        background = _sent(background, gaussians.means)
        if len(gaussians) == 0:
            return _empty(gaussians, camera, background)
        drawn = _without_outliers(gaussians)
        images, alphas, meta = self._rasterization(
            means=drawn.means,
            quats=drawn.quats,
            scales=drawn.scales,
            opacities=drawn.opacities * opacity_compensation(drawn, camera),
            colors=drawn.colors,
            viewmats=_sent(torch.as_tensor(camera.w2c), drawn.means)[None],
            Ks=_sent(_intrinsics(camera), drawn.means)[None],
            width=camera.width,
            height=camera.height,
            near_plane=NEAR_PLANE,
            eps2d=low_pass_filter(drawn.focals, camera.focal_length)[1],
            packed=False,
        )
        # Blended here and not by gsplat, so that the background has a gradient on every version.
        image = images[0] + (1 - alphas[0]) * background
        centers = meta["means2d"]  # [1, G, 2] pixels
        if centers.requires_grad:
            centers.retain_grad()
        visible = (meta["radii"][0] > 0).all(dim=-1)
        return Rendering(image, alphas[0, ..., 0].detach(), visible, _ScreenGradient(centers))


def opacity_compensation(gaussians: Gaussians, camera: Camera) -> Tensor | float:
    """Factors on opacities [G] where an image blurs more than training did; see `low_pass_filter`.

    gsplat's own compensation takes nothing for a Gaussian's own.
    """
    added = low_pass_filter(gaussians.focals, camera.focal_length)
    if added[0] == added[1]:
        return 1.0
    w2c = _sent(torch.as_tensor(camera.w2c), gaussians.means)
    points = gaussians.means @ w2c[:3, :3].T + w2c[:3, 3]
    # What is nearer is not drawn, but must not be infinite.
    points = torch.cat([points[:, :2], points[:, 2:].clamp(min=NEAR_PLANE)], dim=1)
    return blurred(points, gaussians.quats, gaussians.scales, camera, added)[1].clamp(max=1)


@dataclass(frozen=True)
class _ScreenGradient:
    """Reads the gradient that autograd left on gsplat's projected centres."""

    centers: Tensor  # [1, G, 2]

    def __call__(self) -> Tensor:
        grad = self.centers.grad
        return torch.zeros_like(self.centers[0]) if grad is None else grad[0]


def _import_gsplat() -> Any:
    try:
        from gsplat import rasterization  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise MissingExtraError("gsplat", "cuda") from error
    if not torch.cuda.is_available():
        raise MissingExtraError("PyTorch with a CUDA device", "cuda")
    return rasterization


def _without_outliers(g: Gaussians) -> Gaussians:
    """The same Gaussians, with harmless invisible ones for those that are not finite.

    Replaced, not removed, so that nothing waits for the device.
    """
    good = drawable(g)
    rows = good[:, None]
    unit = torch.zeros_like(g.quats)
    unit[:, 0] = 1
    return Gaussians(
        torch.where(rows, g.means, torch.zeros_like(g.means)),
        torch.where(rows, g.quats, unit),
        torch.where(rows, g.scales, torch.ones_like(g.scales)),
        torch.where(good, g.opacities, torch.zeros_like(g.opacities)),
        torch.where(rows, g.colors, torch.zeros_like(g.colors)),
        focals=g.focals,
    )


def _sent(values: Tensor, like: Tensor) -> Tensor:
    return sent(values.to(like.dtype), like.device)


def _intrinsics(camera: Camera) -> Tensor:
    """The pinhole matrix [3, 3]."""
    return torch.tensor([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])


def _empty(gaussians: Gaussians, camera: Camera, background: Tensor) -> Rendering:
    """The background, tied to the Gaussians so that `backward` works."""
    nothing = gaussians.means.sum() * 0
    image = background.expand(camera.height, camera.width, 3) + nothing
    alpha = torch.zeros(camera.height, camera.width, device=image.device)
    visible = torch.zeros(0, dtype=torch.bool, device=image.device)
    return Rendering(image, alpha, visible, lambda: gaussians.means.new_zeros(0, 2))
