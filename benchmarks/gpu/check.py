"""Checks a rasteriser against its oracle and times both.

CUDA's against the CPU's, or the CPU's against plain PyTorch in float64:

    python -m benchmarks.gpu.check --out check.json
    python -m benchmarks.gpu.check --backend cpu --out check.json

Ends with exit code 0 if everything is within `LIMITS`, 1 if not, 2 if the backend is not there.
"""

import json
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

import torch
import tyro
from torch import Tensor

from benchmarks.gpu.machine import machine_record
from benchmarks.gpu.scenes import Case, cases, safe_pixels
from benchmarks.train.raster_scene import bench_scene
from gsynopsis.errors import GsynopsisError
from gsynopsis.model.encoding import grid_features, grid_layout
from gsynopsis.render.base import Gaussians, Renderer, blend_weights, render_depth
from gsynopsis.render.choose import make_renderer
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.render.reference import ReferenceRenderer
from gsynopsis.training.losses import photometric_loss

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
    "grid": 1e-4,
    "loss": 1e-5,
}
"""The largest error that passes.

`image` and `alpha` are absolute, over pixels where no cut-off is near: the error left is float32
arithmetic, sums of up to hundreds of terms below 1 in another order. At the other pixels a Gaussian
of alpha 1/255 may be drawn or not and a pixel may end one Gaussian sooner, hence `image_anywhere`.
Gradients, weights, depth and grid are relative to the largest entry of their tensor; the weights of
a Gaussian may differ by 1/255 at each pixel near a cut-off besides. `unseen` counts Gaussians that
the oracle blends and the backend calls invisible.
"""


@dataclass(frozen=True)
class Settings:
    """Options of the check.

    Attributes:
        backend: Rasteriser to check.
        out: Write the result as JSON.
        rounds: Timed rounds of forward and backward.
        gaussians: Gaussians of the timed scene; 200,000 for CUDA and 300 for the CPU if 0.
        commit: Commit of this tree, if it has no history.
    """

    backend: Literal["cuda", "cpu"] = "cuda"
    out: Path | None = None
    rounds: int = 5
    gaussians: int = 0
    commit: str = ""


@dataclass(frozen=True)
class Side:
    """A rasteriser and the dtype it is asked to compute in."""

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


Metrics = dict[str, float]


def sides(backend: Literal["cuda", "cpu"]) -> tuple[Side, Side]:
    """The backend under test, and its oracle."""
    if backend == "cuda":
        return Side(make_renderer("cuda"), torch.float32), Side(CpuRenderer(), torch.float32)
    return Side(CpuRenderer(), torch.float32), Side(ReferenceRenderer(), torch.float64)


def outcome(side: Side, case: Case, pull: Tensor) -> ViewResult:
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


def compare(found: ViewResult, oracle: ViewResult, safe: Tensor) -> Metrics:
    """Errors by name; every name's last part is a key of `LIMITS`."""
    off = (found.image - oracle.image).abs().amax(dim=2)
    close = int((~safe).sum())
    slack = close / 255
    weights = ((found.weights - oracle.weights).abs() - slack).clamp(min=0)
    blended = oracle.weights > slack + 1e-6
    metrics = {
        "image": _largest(off[safe]),
        "image_anywhere": _largest(off),
        "alpha": _largest((found.alpha - oracle.alpha).abs()[safe]),
        "weights": _largest(weights) / max(_largest(oracle.weights), 1e-12),
        "depth": relative(found.depth[safe], oracle.depth[safe]),
        "unseen": float((blended & ~found.visible).sum()),
    }
    for name, expected in oracle.gradients.items():
        metrics[f"{name}.gradient"] = relative(found.gradients[name], expected)
    return metrics


def relative(found: Tensor, expected: Tensor) -> float:
    """Largest error over the largest expected entry; NaN counts as infinite."""
    return _largest(found - expected) / max(_largest(expected), 1e-12)


def _largest(values: Tensor) -> float:
    if values.numel() == 0:
        return 0.0
    return float(values.abs().nan_to_num(nan=torch.inf).max())


def _plain(values: Tensor) -> Tensor:
    return values.detach().to("cpu", torch.float64)


def check_case(found: Side, oracle: Side, case: Case) -> dict[str, Any]:
    """One scene's errors and which of them are too large."""
    safe = safe_pixels(case)
    generator = torch.Generator().manual_seed(1)
    pull = torch.randn(*safe.shape, 3, generator=generator) * safe[..., None]
    metrics = compare(outcome(found, case, pull), outcome(oracle, case, pull), safe)
    share = {"safe_share": float(safe.double().mean())}
    return judged(case.name, metrics) | share


def check_model(found: Side, oracle: Side) -> list[dict[str, Any]]:
    """The two parts of a training step beside the rasteriser that depend on the device."""
    pairs = zip(_model_tensors(found), _model_tensors(oracle), strict=True)
    errors = [{name: relative(a, b) for name, a in f.items() for b in [o[name]]} for f, o in pairs]
    return [judged(name, e) for name, e in zip(("grid", "loss"), errors, strict=True)]


def _model_tensors(side: Side) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """Grid features and photometric loss with their gradients, by a name ending as in `LIMITS`."""
    generator = torch.Generator().manual_seed(2)
    layout = grid_layout((16, 40, 100), 12)
    u = side.tensor(torch.rand(2000, 3, generator=generator))
    table = side.tensor(torch.randn(layout.rows, layout.features, generator=generator))
    features = grid_features(u, table.requires_grad_(True), layout)
    (grad_table,) = torch.autograd.grad(features.square().sum(), table)
    target = torch.rand(90, 120, 3, generator=generator)
    noise = 0.05 * torch.randn(90, 120, 3, generator=generator)
    image = side.tensor(target + noise).requires_grad_(True)
    loss = photometric_loss(image, side.tensor(target), 0.2)
    (grad_image,) = torch.autograd.grad(loss, image)
    return (
        {"grid": _plain(features), "table.gradient": _plain(grad_table)},
        {"loss": _plain(loss), "image.gradient": _plain(grad_image)},
    )


def judged(name: str, metrics: Metrics) -> dict[str, Any]:
    """A record of a case: its errors and the names of those over their limit."""
    failed = [key for key, value in metrics.items() if not value <= limit_of(key)]
    return {"name": name, "passed": not failed, "failed": failed, "errors": metrics}


def limit_of(name: str) -> float:
    """The limit of an error by the last part of its name."""
    return LIMITS[name.rsplit(".", 1)[-1]]


def time_both(found: Side, oracle: Side, gaussians: int, rounds: int) -> dict[str, Any]:
    """Milliseconds of forward and backward, in turns; the first round does not count."""
    size = (800, 533) if gaussians > 20_000 else (96, 64)
    scene = bench_scene(gaussians, *size, 6.0)
    arrays = [torch.from_numpy(a) for a in (*scene.shape_arrays(), scene.colors)]
    pull, behind = torch.from_numpy(scene.grad_image), torch.from_numpy(scene.background)

    def one_round(side: Side) -> float:
        leaves = [side.tensor(a).requires_grad_(True) for a in arrays]
        background, weights = side.tensor(behind), side.tensor(pull)
        clock = _clock(side.renderer.device)
        start = clock()
        image = side.renderer.render(Gaussians(*leaves), scene.camera(), background).image
        torch.autograd.grad(image, leaves, weights)
        return 1e3 * (clock() - start)

    turns = [(one_round(found), one_round(oracle)) for _ in range(rounds + 1)][1:]
    return {
        "gaussians": gaussians,
        "size": size,
        "rounds": rounds,
        f"{found.renderer.name}_ms": statistics.median(f for f, _ in turns),
        f"{oracle.renderer.name}_ms": statistics.median(o for _, o in turns),
        "ratio": statistics.median(f / o for f, o in turns),
    }


def _clock(device: torch.device) -> Callable[[], float]:
    def now() -> float:
        if device.type == "cuda":
            torch.cuda.synchronize(device)
        return time.perf_counter()

    return now


def print_records(records: list[dict[str, Any]]) -> None:
    """A line a case: the error that is nearest to its limit."""
    for record in records:
        errors: Metrics = record["errors"]
        worst = max(errors, key=lambda k: errors[k] / max(limit_of(k), 1e-12))
        verdict = "ok" if record["passed"] else f"FAILED: {', '.join(record['failed'])}"
        numbers = f"{worst} {errors[worst]:.1e} of {limit_of(worst):.0e}"
        print(f"{record['name']:<8} {numbers:<40} {verdict}")


def main(settings: Settings) -> int:
    """Check, print, write; the exit code."""
    try:
        found, oracle = sides(settings.backend)
    except GsynopsisError as error:
        print(f"gpu check: not run: {error}", file=sys.stderr)
        return 2
    records = [check_case(found, oracle, case) for case in cases()]
    records += check_model(found, oracle)
    print_records(records)
    passed = all(record["passed"] for record in records)
    result = {
        "backend": found.renderer.name,
        "oracle": oracle.renderer.name,
        "passed": passed,
        "limits": LIMITS,
        "checks": records,
        "timing": None,
        "machine": machine_record(found.renderer.device, settings.commit),
    }
    write(settings.out, result)
    if settings.rounds:
        count = settings.gaussians or (200_000 if settings.backend == "cuda" else 300)
        result["timing"] = time_both(found, oracle, count, settings.rounds)
        print("timing  ", json.dumps(result["timing"]))
        write(settings.out, result)
    return 0 if passed else 1


def write(path: Path | None, result: dict[str, Any]) -> None:
    """The result so far, so that a run that is cut short leaves what it had."""
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(result, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings, description=__doc__)))
