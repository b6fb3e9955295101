"""The interface of every rasteriser, and the constants they share.

Constants and statistics as in methods.md §1.6: EWA projection, +0.3 px² dilation, the Jacobian's
x/z and y/z clamped to 1.3 times the half field of view, alpha at most 0.99, skipped below 1/255,
a pixel ends when its transmittance would fall below 1e-4, front to back by camera z.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Protocol

import torch
from torch import Tensor

from gsynopsis.scene.camera import Camera

NEAR_PLANE = 0.01
"""Gaussians whose centre is nearer than this (world units along z) are dropped."""
DILATION = 0.3
"""Added to the diagonal of each projected covariance in training, px²."""
ALPHA_MAX = 0.99
ALPHA_MIN = 1.0 / 255.0
TRANSMITTANCE_MIN = 1e-4
FOV_CLAMP = 1.3
"""x/z and y/z are clamped to this many half fields of view in the Jacobian."""

TrainingFocals = tuple[float, float]
"""Shortest and longest focal length of some photos, pixels, > 0."""
ANTIALIASED: TrainingFocals = (2.0**40, 2.0**40)
"""Focal lengths of no photo: Gaussians have no dilation of their own; images add 0.3 px² and take
the opacity back, as Mip-Splatting and gsplat's *antialiased* do (`low_pass_filter`)."""


@dataclass(frozen=True)
class Gaussians:
    """G anisotropic Gaussians in world space, after all activations, one device and dtype."""

    means: Tensor  # [G, 3] world units
    quats: Tensor  # [G, 4] w, x, y, z; normalised by the renderer
    scales: Tensor  # [G, 3] standard deviations, world units, > 0
    opacities: Tensor  # [G] in [0, 1]
    colors: Tensor  # [G, 3] linear combination weights, usually RGB in [0, 1]
    focals: TrainingFocals | None = field(default=None, kw_only=True)
    """Focal lengths of photos at training resolution (`Camera.focal_length`); None: unknown.

    Without them every camera counts as one of training.
    """

    def __len__(self) -> int:
        return self.means.shape[0]


@dataclass(frozen=True)
class Rendering:
    """One image and what training wants to know about it.

    Attributes:
        image: [H, W, 3], background blended in, differentiable.
        alpha: [H, W], 1 minus the remaining transmittance, not differentiable.
        visible: [G] bool, the Gaussian passed culling and could touch a pixel.
        screen_grad: Call it after `backward`: the gradient of the loss with respect to each
            Gaussian's projected centre, [G, 2] in 1/pixels, zeros where not visible. The
            statistic of growing is its norm after scaling by (W/2, H/2).
    """

    image: Tensor
    alpha: Tensor
    visible: Tensor
    screen_grad: Callable[[], Tensor]


class Renderer(Protocol):
    """Rasterises Gaussians. Implementations keep no state that changes a later image."""

    @property
    def name(self) -> str:
        """`reference`, `cpu`, `cuda` or `webgpu`."""
        ...

    @property
    def device(self) -> torch.device:
        """Device of the tensors of `Gaussians` and of images."""
        ...

    def render(self, gaussians: Gaussians, camera: Camera, background: Tensor) -> Rendering:
        """Rasterise.

        Args:
            gaussians: May be empty; nothing is modified.
            camera: Any pinhole camera.
            background: [3], blended behind everything.

        Returns:
            A rendering; the image is the background where nothing was hit.
        """
        ...


def sent(values: Tensor, device: torch.device) -> Tensor:
    """Small host values on a device, in step with its work: the host does not wait for it.

    Values already on the device, as all are on the CPU, are returned as they are.
    """
    if device.type == "cuda" and values.device.type == "cpu":
        values = values.pin_memory()
    return values.to(device, non_blocking=True)


@lru_cache(maxsize=512)
def low_pass_filter(focals: TrainingFocals | None, focal_length: float) -> tuple[float, float]:
    """Low-pass filter on projected covariances, px² on the diagonal: Gaussians' own part, and all.

    Training adds `DILATION` to each projection, and that becomes part of a Gaussian's look. In an
    image of r times the focal length it is 0.3 r² px²: the Gaussian's own part. A smaller image is
    blurred further, up to 0.3 px² in all; and as a blur spreads the same mass over more pixels,
    opacity is multiplied by √(det with its own / det with all). So a scene neither thickens in
    small images nor comes apart in large ones (ours; the blur is that of Mip-Splatting and of
    gsplat's *antialiased*, which count no part as a Gaussian's own and must be trained with).

    Args:
        focals: See `Gaussians.focals`.
        focal_length: Of the image's camera, pixels.
    """
    if focals is None:
        return DILATION, DILATION
    shortest, longest = focals
    ratio = focal_length / min(max(focal_length, shortest), longest)
    own = DILATION * ratio * ratio
    return own, max(own, DILATION)
