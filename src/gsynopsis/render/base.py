"""The interface of every rasteriser, and the constants they share.

Constants and statistics as in methods.md §1.6: EWA projection, +0.3 px² dilation, the Jacobian's
x/z and y/z clamped to 1.3 times the half field of view, alpha at most 0.99, skipped below 1/255,
a pixel ends when its transmittance would fall below 1e-4, front to back by camera z.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
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
SIGN_SAMPLES = 2
"""Sets of random signs by which the effect of a Gaussian on an image is estimated."""

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
    """Focal lengths of the training photos at training resolution (`focal_length`); None: unknown.

    Without them every camera counts as one of training.
    """

    def __len__(self) -> int:
        return self.means.shape[0]


class Trained(Protocol):
    """A level, a model or Gaussians with the focal lengths of their training photos."""

    @property
    def focals(self) -> TrainingFocals | None:
        """See `Gaussians.focals`."""
        ...


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


def focal_length(camera: Camera) -> float:
    """Focal length in pixels, one for both axes: their geometric mean."""
    return math.sqrt(camera.fx * camera.fy)


def low_pass_filter(gaussians: Trained, camera: Camera) -> tuple[float, float]:
    """Low-pass filter on projected covariances, px² on the diagonal: Gaussians' own part, and all.

    Training adds `DILATION` to each projection, and that becomes part of a Gaussian's look. In an
    image of r times the focal length it is 0.3 r² px²: the Gaussian's own part. A smaller image is
    blurred further, up to 0.3 px² in all; and as a blur spreads the same mass over more pixels,
    opacity is multiplied by √(det with its own / det with all). So a scene neither thickens in
    small images nor comes apart in large ones (ours; the blur is that of Mip-Splatting and of
    gsplat's *antialiased*, which count no part as a Gaussian's own and must be trained with).
    """
    if gaussians.focals is None:
        return DILATION, DILATION
    shortest, longest = gaussians.focals
    here = focal_length(camera)
    ratio = here / min(max(here, shortest), longest)
    own = DILATION * ratio * ratio
    return own, max(own, DILATION)


def blend_weights(renderer: Renderer, gaussians: Gaussians, camera: Camera) -> Tensor:
    """Sum over all pixels of alpha times transmittance of each Gaussian, [G], in pixels.

    The image is linear in the colours with exactly these weights, so the gradient of the sum of
    one channel gives them on any backend (the contribution score of methods.md §2.2).
    """
    if len(gaussians) == 0:
        return gaussians.opacities.new_zeros(0)
    with torch.enable_grad():
        colors = torch.zeros_like(gaussians.colors).requires_grad_(True)
        leaf = Gaussians(
            gaussians.means.detach(),
            gaussians.quats.detach(),
            gaussians.scales.detach(),
            gaussians.opacities.detach(),
            colors,
            focals=gaussians.focals,
        )
        image = renderer.render(leaf, camera, colors.new_zeros(3)).image
        (weights,) = torch.autograd.grad(image[..., 0].sum(), colors)
    return weights[:, 0]


def removal_effects(
    renderer: Renderer,
    gaussians: Gaussians,
    camera: Camera,
    background: Tensor,
    chance: torch.Generator,
) -> Tensor:
    """Squared change of the image if a Gaussian is left out, summed over pixels and channels.

    A pixel is linear in every single opacity, but for the limits of alpha and transmittance, so
    leaving one out changes it by opacity times gradient. The gradient of the image times random
    signs gives the sum of squares over all pixels on average (Hutchinson's estimate; ours).

    Args:
        renderer: Draws.
        gaussians: May be empty; nothing is modified.
        camera: Any pinhole camera.
        background: [3].
        chance: Of the signs, on the CPU.

    Returns:
        [G] ≥ 0, an unbiased estimate from `SIGN_SAMPLES` sets of signs, 0 if not rendered.
    """
    effects = torch.zeros_like(gaussians.opacities)
    if len(gaussians) == 0:
        return effects
    with torch.enable_grad():
        opacities = gaussians.opacities.detach().clone().requires_grad_(True)
        image = renderer.render(replace(gaussians, opacities=opacities), camera, background).image
        for _ in range(SIGN_SAMPLES):
            signs = random_signs(image, chance)
            # Of a number, not of the image with weights: that would import torch's compiler.
            (grad,) = torch.autograd.grad((image * signs).sum(), opacities, retain_graph=True)
            effects += (grad * opacities.detach()).square() / SIGN_SAMPLES
    return effects


def random_signs(image: Tensor, chance: torch.Generator) -> Tensor:
    """-1 or 1 for every value of an image, of its dtype and device; `chance` is on the CPU.

    The gradient of a backward pass from them is, squared and on average, the sum of the
    squares of its gradients over the image (Hutchinson's estimate).
    """
    return torch.randint(0, 2, image.shape, generator=chance).to(image) * 2 - 1


def render_depth(renderer: Renderer, gaussians: Gaussians, camera: Camera) -> Tensor:
    """Expected depth along the camera's z, [H, W] world units, 0 where nothing was hit.

    Computed as blended z divided by alpha, so that a half transparent surface keeps its depth.
    """
    w2c = torch.as_tensor(camera.w2c, dtype=gaussians.means.dtype, device=gaussians.means.device)
    z = gaussians.means @ w2c[2, :3] + w2c[2, 3]
    colors = torch.stack([z, z, z], dim=1)
    rendering = renderer.render(
        replace(gaussians, colors=colors), camera, gaussians.means.new_zeros(3)
    )
    alpha = rendering.alpha
    depth = rendering.image[..., 0] / alpha.clamp(min=1e-6)
    return torch.where(alpha > 1e-3, depth, torch.zeros_like(depth))
