"""Measures of Gaussians by any renderer: weight in an image, effect of removal, depth."""

from dataclasses import replace

import torch
from torch import Tensor

from gsynopsis.render.base import Gaussians, Renderer
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import Camera

SIGN_SAMPLES = 2
"""Sets of random signs by which the effect of a Gaussian on an image is estimated."""


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
    """Squared change of the image without a Gaussian, summed over pixels and channels (ours).

    A pixel is linear in every single opacity, but for the limits of transmittance. The CPU's kernel
    adds up the changes that follow; other renderers estimate their sum, see
    `sampled_removal_effects`.

    Args:
        renderer: Draws.
        gaussians: May be empty; nothing is modified.
        camera: Any pinhole camera.
        background: [3].
        chance: Of the estimate's signs, on the CPU.

    Returns:
        [G] ≥ 0, 0 if not rendered.
    """
    if isinstance(renderer, CpuRenderer):
        return renderer.removal_effects(gaussians, camera, background).to(gaussians.opacities)
    return sampled_removal_effects(renderer, gaussians, camera, background, chance)


def sampled_removal_effects(
    renderer: Renderer,
    gaussians: Gaussians,
    camera: Camera,
    background: Tensor,
    chance: torch.Generator,
) -> Tensor:
    """An unbiased estimate of `removal_effects` from `SIGN_SAMPLES` sets of signs, by any renderer.

    Leaving a Gaussian out changes a pixel by opacity times gradient; where alpha is capped, by
    nothing. The gradient of the image times random signs gives the sum of squares over all pixels
    on average (Hutchinson's estimate).
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
