"""Steps of the full training with many Gaussians in large images: the share of each part.

    python -m benchmarks.train.large_steps --page docs/results/large_steps.md

A made-up cloud of points that every camera sees whole, preset `ours` as it begins. Each row is a
process of its own, so that its memory is its own.
"""

import statistics
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import torch
import tyro

from benchmarks.bench import machine, put, short_commit
from benchmarks.robust.memory import Blank, peak
from benchmarks.train.step import OurSteps, Timing, measure_parts
from gsynopsis._native.buffer_pool import reused
from gsynopsis.config import Joint, resolve_settings
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.scene import Scene
from gsynopsis.scene.views import View
from gsynopsis.training.context import TrainContext
from gsynopsis.training.phases.full import FullPhase
from gsynopsis.training.state import fresh_state

SIZES = ((800, 533), (1600, 1066))
POINTS = (12_000, 60_000, 240_000)
"""Points of the clouds: about 0.1, 0.5 and 2 million Gaussians in view."""
VIEWS, WARM = 4, 3
MIB = 2**20


@dataclass(frozen=True)
class Options:
    """Options of the timing.

    Attributes:
        rounds: Steps of each row.
        threads: Threads of each step.
        page: Write the table between the marks of this page.
    """

    rounds: int = 5
    threads: int = 2
    page: Path | None = None


@dataclass
class Measured:
    """One row."""

    width: int
    height: int
    timing: Timing
    pairs: int
    peak_bytes: int


def cloud(points: int, width: int, height: int) -> Scene:
    """Points in a ball, cameras in front of it, each a little beside the last."""
    rng = np.random.default_rng(0)
    places = rng.normal(size=(points, 3))
    places *= rng.uniform(0, 1, (points, 1)) ** (1 / 3) / np.linalg.norm(places, axis=1)[:, None]
    views: list[View] = []
    for k in range(VIEWS):
        w2c = np.eye(4)
        w2c[:3, 3] = 0.05 * k, 0, 2.6
        name = f"{width}x{height}.{k}"
        camera = Camera(width, height, height, height, width / 2, height / 2, w2c)
        views.append(View(name, camera, Path(name)))
    colors, every = rng.integers(0, 256, (points, 3), np.uint8), tuple(range(VIEWS))
    return Scene("cloud", Path("cloud"), tuple(views), places, colors, every, every, cache=Blank())


def measure(points: int, width: int, height: int, rounds: int, threads: int) -> Measured:
    """Steps in this process."""
    torch.set_num_threads(threads)
    # So long a training that the timed steps are counted for growth, and none grows.
    asked = {"train.steps": 60 * WARM, "train.growth.every": 10_000}
    config = resolve_settings("ours", None, asked).config
    assert isinstance(config.levels, Joint)
    state = fresh_state(TrainContext(cloud(points, width, height), config, CpuRenderer()))
    contender = OurSteps(state, FullPhase(config.train.steps, config.train.steps))
    timing = Timing()
    with reused():  # as in a training
        for _ in range(WARM + 1):
            contender.step()
        contender.count(timing)
        for _ in range(rounds):
            timing.add(contender.step)
        measure_parts(contender, timing, rounds)
    renderer = state.context.renderer
    assert isinstance(renderer, CpuRenderer)
    return Measured(width, height, timing, renderer._free_frames[-1].pairs, peak())


def table(rows: list[Measured]) -> str:
    """All rows."""
    names = ("rasteriser", "heads and codebook", "assembly", "loss", "Adam", "everything else")
    lines = [
        "| pictures | Gaussians | anchors | pairs with tiles | ms (median) | "
        + " | ".join(f"{name}, %" for name in names)
        + " | memory, MiB |",
        "|---" * (6 + len(names)) + "|",
    ]
    for row in rows:
        parts = {name: statistics.median(ms) for name, ms in row.timing.parts.items()}
        whole = sum(parts.values())
        shares: list[str] = []
        for name in names:
            own = [part for part in parts if part.startswith(name.split()[0])]
            shares.append(f"{100 * sum(parts.pop(part) for part in own) / whole:.0f}")
        # Culling and gathering are small; they count as everything else.
        rest = float(shares.pop()) + 100 * sum(parts.values()) / whole
        t = row.timing
        cells = [f"{row.width:,} × {row.height:,}", f"{t.gaussians:,}", f"{t.anchors:,}"]
        cells += [f"{row.pairs:,}", f"{statistics.median(t.wall):,.0f}", *shares, f"{rest:.0f}"]
        lines.append("| " + " | ".join([*cells, f"{row.peak_bytes / MIB:,.0f}"]) + " |")
    return "\n".join(lines)


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    rows: list[Measured] = []
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as pool:
        for width, height in SIZES:
            for points in POINTS:
                case = points, width, height, options.rounds, options.threads
                rows.append(pool.submit(measure, *case).result())
                print(rows[-1].width, rows[-1].timing.gaussians, rows[-1].timing.wall, flush=True)
    facts = machine()
    text = (
        f"{table(rows)}\n\nMedians of {options.rounds} steps, seed 0; {facts.cpu}, "
        f"{options.threads} threads, commit {short_commit()}."
    )
    print(text)
    if options.page is not None:
        put(options.page, __file__, text)


if __name__ == "__main__":
    main()
