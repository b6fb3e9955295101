"""Times the CPU rasteriser: every variant, autograd and the PyTorch reference.

    python -m benchmarks.train.raster --out raster.json

All contenders take turns in one run, because timings of a shared machine are only good as ratios.
A round of one contender is projection, sorting, blending and the whole backward pass.
"""

import json
import os
import resource
import statistics
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch
import tyro

from benchmarks.bench import machine, short_commit
from benchmarks.train.raster_scene import ArrayScene, bench_scene
from gsynopsis._native import _core
from gsynopsis.render.base import DILATION, Gaussians, Renderer
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.render.reference import ReferenceRenderer


@dataclass(frozen=True)
class Settings:
    """Options of the timing."""

    gaussians: int = 200_000
    width: int = 800
    height: int = 533
    radius: float = 6.0
    """Mean of three times the larger standard deviation on the image, pixels."""
    threads: int = 2
    rounds: int = 15
    out: Path | None = None
    """Write the result as JSON."""


@dataclass
class Timing:
    """Milliseconds of each round."""

    forward: list[float] = field(default_factory=list)
    backward: list[float] = field(default_factory=list)
    stages: dict[str, list[float]] = field(default_factory=dict)

    def total(self) -> list[float]:
        """Forward and backward of each round."""
        return [f + b for f, b in zip(self.forward, self.backward, strict=True)]

    def add(self, marks: tuple[float, float, float], stages: dict[str, float]) -> None:
        """Takes over one round."""
        start, middle, end = marks
        self.forward.append(1e3 * (middle - start))
        self.backward.append(1e3 * (end - middle))
        for name, ms in stages.items():
            self.stages.setdefault(name, []).append(ms)


Round = Callable[[], tuple[tuple[float, float, float], dict[str, float]]]


class NativeFrame:
    """The bare kernels, without autograd, into buffers made once."""

    def __init__(self, scene: ArrayScene, variant: str, threads: int) -> None:
        self.frame = _core.Frame(variant)
        self._scene, self._threads = scene, threads
        count, shape = len(scene.means), (scene.height, scene.width)
        self._image = np.empty((*shape, 3), np.float32)
        self._alpha = np.empty(shape, np.float32)
        self._visible = np.empty(count, np.uint8)
        self._grads = [np.empty_like(a) for a in (*scene.shape_arrays(), scene.colors)]
        self._screen = np.empty((count, 2), np.float32)

    def __call__(self) -> tuple[tuple[float, float, float], dict[str, float]]:
        """One round."""
        scene = self._scene
        means, quats, scales, opacities = scene.shape_arrays()
        start = time.perf_counter()
        self.frame.render(
            means,
            quats,
            scales,
            opacities,
            scene.colors,
            np.eye(4, dtype=np.float32),
            (scene.focal, scene.focal, scene.width / 2, scene.height / 2),
            (DILATION, DILATION),
            scene.background,
            self._image,
            self._alpha,
            self._visible,
            self._threads,
        )
        middle = time.perf_counter()
        g_means, g_quats, g_scales, g_opacities, g_colors = self._grads
        self.frame.backward(
            means,
            quats,
            scales,
            opacities,
            self._image,
            scene.grad_image,
            g_means,
            g_quats,
            g_scales,
            g_opacities,
            g_colors,
            self._screen,
            self._threads,
        )
        return (start, middle, time.perf_counter()), self.frame.stage_ms


def autograd_round(renderer: Renderer, scene: ArrayScene) -> Round:
    """Time of the renderer with its autograd function, as in a training step."""
    arrays = (*scene.shape_arrays(), scene.colors)
    leaves = [torch.from_numpy(a).clone().requires_grad_(True) for a in arrays]
    background = torch.from_numpy(scene.background)
    grad_image = torch.from_numpy(scene.grad_image)

    def one_round() -> tuple[tuple[float, float, float], dict[str, float]]:
        start = time.perf_counter()
        rendering = renderer.render(Gaussians(*leaves), scene.camera(), background)
        middle = time.perf_counter()
        torch.autograd.grad(rendering.image, leaves, grad_image)
        return (start, middle, time.perf_counter()), {}

    return one_round


def take_turns(contenders: dict[str, Round], rounds: int) -> dict[str, Timing]:
    """Runs every contender once a round; the first round warms up and does not count."""
    timings = {name: Timing() for name in contenders}
    for i in range(rounds + 1):
        for name, one_round in contenders.items():
            marks, stages = one_round()
            if i > 0:
                timings[name].add(marks, stages)
    return timings


def ratio(ours: Timing, theirs: Timing) -> float:
    """Median over the rounds of our time over theirs."""
    pairs = zip(ours.total(), theirs.total(), strict=True)
    return statistics.median(a / b for a, b in pairs)


def summary(timings: dict[str, Timing], yardstick: str | None) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []
    for name, timing in timings.items():
        row: dict[str, object] = {
            "name": name,
            "forward_ms": statistics.median(timing.forward),
            "backward_ms": statistics.median(timing.backward),
            "total_ms": statistics.median(timing.total()),
            "fastest_ms": min(timing.total()),
            "stages_ms": {k: statistics.median(v) for k, v in timing.stages.items()},
        }
        if yardstick is not None:
            row["ratio"] = ratio(timing, timings[yardstick])
        rows.append(row)
    return rows


def print_table(title: str, rows: Iterable[dict[str, object]], yardstick: str | None) -> None:
    print(title)
    print(f"{'':24}{'forward':>9}{'backward':>10}{'total ms':>10}{'fastest':>9}{'ratio':>8}")
    for row in rows:
        numbers = [row[k] for k in ("forward_ms", "backward_ms", "total_ms", "fastest_ms")]
        line = f"{row['name']:<24}{numbers[0]:>9.1f}{numbers[1]:>10.1f}"
        line += f"{numbers[2]:>10.1f}{numbers[3]:>9.1f}"
        print(line + (f"{row['ratio']:>8.3f}" if "ratio" in row else ""))
        if row["stages_ms"]:
            stages = row["stages_ms"]
            assert isinstance(stages, dict)
            print("    " + "  ".join(f"{k} {v:.1f}" for k, v in stages.items()))
    if yardstick is not None:
        print(f"ratio: total over that of {yardstick}, median of the rounds")
    print()


def of_variants(settings: Settings) -> dict[str, object]:
    """The large scene: every variant, and our renderer with autograd."""
    scene = bench_scene(settings.gaussians, settings.width, settings.height, settings.radius)
    frames = {v: NativeFrame(scene, v, settings.threads) for v in _core.variants()}
    contenders: dict[str, Round] = dict(frames)
    contenders["renderer, autograd"] = autograd_round(CpuRenderer(settings.threads), scene)
    rows = summary(take_turns(contenders, settings.rounds), None)
    size = f"{settings.width}×{settings.height}"
    title = f"{settings.gaussians} Gaussians at {size}, {settings.threads} threads"
    print_table(title, rows, None)
    best = next(iter(frames.values())).frame
    return {"contenders": rows, "pairs": best.pairs, "frame_mib": best.bytes / 2**20}


def against_reference(settings: Settings) -> dict[str, object]:
    """A scene small enough for the PyTorch reference."""
    scene = bench_scene(2000, 96, 64, 6.0)
    contenders = {
        "cpu renderer": autograd_round(CpuRenderer(settings.threads), scene),
        "PyTorch reference": autograd_round(ReferenceRenderer(), scene),
    }
    rows = summary(take_turns(contenders, 5), "PyTorch reference")
    print_table("2000 Gaussians at 96×64, with autograd", rows, "PyTorch reference")
    return {"contenders": rows}


def main(settings: Settings) -> None:
    torch.set_num_threads(settings.threads)
    result = {
        "settings": {k: str(v) if isinstance(v, Path) else v for k, v in asdict(settings).items()},
        "commit": short_commit(),
        "machine": asdict(machine()),
        "variants": _core.variants(),
        "load_average": os.getloadavg()[0],
        "large": of_variants(settings),
        "small": against_reference(settings),
        "peak_memory_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }
    print(f"peak memory of the process {result['peak_memory_mib']:.0f} MiB")
    if settings.out is not None:
        settings.out.parent.mkdir(parents=True, exist_ok=True)
        settings.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main(tyro.cli(Settings, description=__doc__))
