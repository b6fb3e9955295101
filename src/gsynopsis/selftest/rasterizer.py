"""A rasterizer against its oracle: images, gradients and weights of small scenes.

CUDA's against the CPU's, or the CPU's against plain PyTorch in float64.
"""

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from gsynopsis.render.base import Gaussians, Renderer
from gsynopsis.render.measures import blend_weights, render_depth
from gsynopsis.selftest.findings import Finding, judged, largest, relative
from gsynopsis.selftest.raster_cases import Case, cases, safe_pixels

FIELDS = [field.name for field in fields(Gaussians) if field.name != "focals"]
BACKGROUND = (0.1, 0.2, 0.3)
LIMITS = {
    "image": 2e-4,
    "image_anywhere": 1e-2,
    "alpha": 2e-4,
    "gradient": 1e-3,
    "weights": 1e-3,
    "depth": 1e-3,
    "unseen": 0.0,
}
"""The largest error that passes.

`image` and `alpha` are absolute, over pixels where no cut-off is near: the error left is float32
arithmetic, sums of up to hundreds of terms below 1 in another order. At the other pixels a Gaussian
of alpha 1/255 may be drawn or not and a pixel may end one Gaussian sooner, hence `image_anywhere`.
Gradients, weights and depth are relative to the largest entry of their tensor; the weights of
a Gaussian may differ by 1/255 at each pixel near a cut-off besides. `unseen` counts Gaussians that
the oracle blends and the other calls invisible.
"""


@dataclass(frozen=True)
class Side:
    """A rasterizer and the dtype it is asked to compute in."""

    renderer: Renderer
    dtype: torch.dtype

    def tensor(self, values: Tensor) -> Tensor:
        """A copy of the values where this side computes."""
        return values.detach().to(self.renderer.device, self.dtype, copy=True)


@dataclass(frozen=True)
class ViewResult:
    """Results of a case, on the CPU in float64."""

    image: Tensor  # [H, W, 3]
    alpha: Tensor  # [H, W]
    visible: Tensor  # [G] bool
    weights: Tensor  # [G] pixels
    depth: Tensor  # [H, W] world units
    gradients: dict[str, Tensor]


def check_rasterizer(found: Side, oracle: Side, some: list[Case] | None = None) -> list[Finding]:
    """The errors of a rasterizer on small scenes; `some`: others than `cases()`."""
    return [check_case(found, oracle, case) for case in some or cases()]


def check_case(found: Side, oracle: Side, case: Case) -> Finding:
    """One scene's errors."""
    safe = safe_pixels(case.gaussians, case.camera)
    generator = torch.Generator().manual_seed(1)
    pull = torch.randn(*safe.shape, 3, generator=generator) * safe[..., None]
    errors = compare(render_case(found, case, pull), render_case(oracle, case, pull), safe)
    return judged(case.name, errors, LIMITS)


def render_case(side: Side, case: Case, pull: Tensor) -> ViewResult:
    """Draw a case and differentiate the sum of the image times `pull` [H, W, 3]."""
    leaves = [side.tensor(getattr(case.gaussians, name)).requires_grad_(True) for name in FIELDS]
    background = side.tensor(torch.tensor(BACKGROUND)).requires_grad_(True)
    gaussians = Gaussians(*leaves, focals=case.gaussians.focals)
    renderer = side.renderer
    drawn = renderer.render(gaussians, case.camera, background)
    (drawn.image * side.tensor(pull)).sum().backward()
    named = zip([*FIELDS, "background"], [*leaves, background], strict=True)
    found = {n: torch.zeros_like(t) if t.grad is None else t.grad for n, t in named}
    gradients = {**found, "screen": drawn.screen_grad()}
    with torch.no_grad():
        depth = render_depth(renderer, gaussians, case.camera)
    return ViewResult(
        _plain(drawn.image),
        _plain(drawn.alpha),
        drawn.visible.cpu(),
        _plain(blend_weights(renderer, gaussians, case.camera)),
        _plain(depth),
        {name: _plain(value) for name, value in gradients.items()},
    )


def compare(found: ViewResult, oracle: ViewResult, safe: Tensor) -> dict[str, float]:
    """Errors by name; every name's last part is a key of `LIMITS`."""
    off = (found.image - oracle.image).abs().amax(dim=2)
    close = int((~safe).sum())
    slack = close / 255
    weights = ((found.weights - oracle.weights).abs() - slack).clamp(min=0)
    blended = oracle.weights > slack + 1e-6
    errors = {
        "image": largest(off[safe]),
        "image_anywhere": largest(off),
        "alpha": largest((found.alpha - oracle.alpha).abs()[safe]),
        "weights": largest(weights) / max(largest(oracle.weights), 1e-12),
        "depth": relative(found.depth[safe], oracle.depth[safe]),
        "unseen": float((blended & ~found.visible).sum()),
    }
    for name, expected in oracle.gradients.items():
        errors[f"{name}.gradient"] = relative(found.gradients[name], expected)
    return errors


def _plain(values: Tensor) -> Tensor:
    return values.detach().to("cpu", torch.float64)
