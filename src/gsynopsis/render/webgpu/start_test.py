"""A device's test at start: 200 Gaussians, image and gradients against the CPU, below a second.

Drivers fail silently: float sums off by thousands, splats that turn into rays. What is wrong there
is wrong by far, so the limits are wide.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gsynopsis.render.base import Gaussians, Renderer
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import Camera

COUNT, WIDTH, HEIGHT = 200, 80, 60
LIMITS = {"image": 1e-3, "gradients": 1e-2}
"""Largest error that passes: root mean square of the image, and the length of the gradients' error
relative to their own. Rounding at alpha's cut-off of 1/255 alone gives a tenth of that."""


@dataclass(frozen=True)
class StartTest:
    """Errors by name, see `LIMITS`; infinite where a value is not finite."""

    errors: dict[str, float]

    @property
    def passed(self) -> bool:
        """All errors are within their limits."""
        return all(self.errors[name] <= most for name, most in LIMITS.items())

    def text(self) -> str:
        """Every error, and the limit of those that are over it."""
        pieces: list[str] = []
        for name, error in self.errors.items():
            most = LIMITS[name]
            pieces.append(f"{name} {error:.0e}" + (f" of at most {most:g}" if error > most else ""))
        return ", ".join(pieces)


def run_start_test(renderer: Renderer) -> StartTest:
    """Compare a renderer with the CPU's on a small scene."""
    camera = Camera(WIDTH, HEIGHT, 70.0, 72.0, 41.0, 29.0, np.eye(4))
    oracle, found = (_rendered(r, camera) for r in (CpuRenderer(), renderer))
    apart = (found[0] - oracle[0]).square().mean().sqrt()
    off = (found[1] - oracle[1]).norm() / oracle[1].norm()
    errors = {"image": float(apart), "gradients": float(off)}
    return StartTest({k: e if np.isfinite(e) else float("inf") for k, e in errors.items()})


def _rendered(renderer: Renderer, camera: Camera) -> tuple[Tensor, Tensor]:
    """An image and all gradients in one, those in world units times the Gaussian's size."""
    rng = np.random.default_rng(58)
    depths = rng.uniform(1, 6, COUNT)
    pixels = rng.uniform(-0.1, 1.1, (COUNT, 2)) * [WIDTH, HEIGHT]
    sideways = (pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy] * depths[:, None]
    sizes = np.exp(rng.normal(0, 0.6, (COUNT, 3))) * (3.0 * depths / camera.fx)[:, None]
    arrays = (
        np.concatenate([sideways, depths[:, None]], axis=1),
        rng.normal(size=(COUNT, 4)),
        sizes,
        rng.uniform(0.02, 0.95, COUNT),
        rng.uniform(0, 1, (COUNT, 3)),
    )
    leaves = [torch.from_numpy(a.astype(np.float32)).requires_grad_(True) for a in arrays]
    gaussians = Gaussians(*leaves)
    image = renderer.render(gaussians, camera, torch.tensor([0.1, 0.2, 0.3])).image
    pull = torch.from_numpy(rng.normal(size=tuple(image.shape)).astype(np.float32))
    (image * pull).sum().backward()
    grads = [torch.zeros(0) if leaf.grad is None else leaf.grad.flatten() for leaf in leaves]
    weights = torch.from_numpy(sizes.astype(np.float32)).flatten()
    grads[0], grads[2] = grads[0] * weights, grads[2] * weights  # world units to shares
    return image.detach(), torch.cat(grads)
