"""Steps of the full training with many Gaussians in large images: the share of each part.

    python -m benchmarks.train.large_steps --page docs/results/speed.md

A made-up cloud of points that every camera sees whole, our model as it begins. Each row is a
process of its own, so that its memory is its own. With a page rows go to
docs/results/large_steps.csv, and a line to the page.
"""

import statistics
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import torch
import tyro

from benchmarks.bench import RESULTS, Row, machine, put, short_commit, write_rows
from benchmarks.robust.memory import Blank, peak
from benchmarks.train.step import OurSteps, Timing, measure_parts
from gsynopsis._native.runtime import reused
from gsynopsis.config import Joint, resolve_settings
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.scene import Scene
from gsynopsis.scene.views import View
from gsynopsis.training.context import TrainContext
from gsynopsis.training.phases.full import FullPhase
from gsynopsis.training.state import fresh_state

CSV = RESULTS / "large_steps.csv"
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
        threads: Of each step.
        page: Write the CSV, and a line between the marks of this page.
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
    config = resolve_settings("max", None, asked).config
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


PARTS = ("rasteriser", "heads and codebook", "assembly", "loss", "Adam", "everything else")


def row_of(found: Measured) -> Row:
    """Medians, and the percent of the step that each part takes."""
    parts = {name: statistics.median(ms) for name, ms in found.timing.parts.items()}
    whole = sum(parts.values())
    shares = dict[str, float]()
    for name in PARTS:
        own = [part for part in parts if part.startswith(name.split()[0])]
        shares[name] = 100 * sum(parts.pop(part) for part in own) / whole
    # Culling and gathering are small; they count as everything else.
    shares[PARTS[-1]] += 100 * sum(parts.values()) / whole
    timing = found.timing
    return {
        "width": found.width,
        "height": found.height,
        "gaussians": timing.gaussians,
        "anchors": timing.anchors,
        "pairs": found.pairs,
        "ms": round(statistics.median(timing.wall)),
        **{f"{name.replace(' ', '_')}_percent": round(share) for name, share in shares.items()},
        "memory_mib": round(found.peak_bytes / MIB),
    }


def text_of(rows: list[Row]) -> str:
    """Milliseconds and the rasteriser's share, by the pictures' size."""
    parts = list[str]()
    for width, height in dict.fromkeys((row["width"], row["height"]) for row in rows):
        own = [row for row in rows if row["width"] == width]
        counts = " / ".join(f"{row['gaussians'] / 1e6:.1f}" for row in own)
        times = " / ".join(f"{row['ms']:,}" for row in own)
        shares = " / ".join(f"{row['rasteriser_percent']}" for row in own)
        parts.append(
            f"{width:,} × {height:,} pixels, {counts} million Gaussians: {times} ms, of which the "
            f"rasteriser takes {shares} %"
        )
    return f"{'; '.join(parts)}."


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
    table = [row_of(row) for row in rows]
    text = (
        f"{text_of(table)}\n\nMedians of {options.rounds} steps, seed 0; {facts.cpu}, "
        f"{options.threads} threads, commit {short_commit()}."
    )
    print(text)
    if options.page is not None:
        write_rows(CSV, table)
        put(options.page, __file__, text)


if __name__ == "__main__":
    main()
