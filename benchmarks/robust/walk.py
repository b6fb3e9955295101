"""Time and memory of steps whose views see little of a scene.

    OMP_NUM_THREADS=2 python -m benchmarks.robust.walk

A long street of points, of which each camera sees a stretch. Each row is a process of its own.
Written to docs/results/walk.csv.
"""

import os
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import tyro

from benchmarks.bench import RESULTS, machine, memory_of, short_commit, write_rows
from benchmarks.robust.memory import Blank
from gsynopsis._native.runtime import one_torch_thread
from gsynopsis.config import resolve_settings
from gsynopsis.jobs.write_file import FilePacker
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.scene import Scene
from gsynopsis.scene.views import View
from gsynopsis.training.context import TrainContext
from gsynopsis.training.loop import phases_of
from gsynopsis.training.optim.param_groups import row_parameters
from gsynopsis.training.state import TrainState, fresh_state, set_optimizer

CSV = RESULTS / "walk.csv"
MIB = 2**20
SIZE = 160, 120
FIRST = 12
"""Steps before those that are timed."""
STEPS = 24
"""Steps that are timed."""


@dataclass(frozen=True)
class Case:
    """A street.

    Attributes:
        points: In it.
        views: Along it, each of which sees about three shares of it.
    """

    points: int
    views: int


CASES = (
    Case(20_000, 4),
    Case(100_000, 8),
    Case(100_000, 40),
    Case(400_000, 40),
    Case(400_000, 160),
    Case(2_000_000, 800),
)
"""Values and moments of the last one are 1.4 GiB."""


@dataclass(frozen=True)
class Options:
    """Streets to measure.

    Attributes:
        only: Numbers of the cases, from 0; all if none is given, and then the CSV is written.
    """

    only: tuple[int, ...] = ()


def street(case: Case) -> Scene:
    """Points in a long box, cameras along it."""
    length = float(case.views)
    points = np.random.default_rng(0).uniform(-1, 1, (case.points, 3)) * (length, 1, 1)
    views: list[View] = []
    for k in range(case.views):
        w2c = np.eye(4)
        w2c[:3, 3] = length - 2 * k - 1, 0, 3
        name = f"{SIZE[0]}x{SIZE[1]}.{k}"
        camera = Camera(*SIZE, SIZE[0], SIZE[0], SIZE[0] / 2, SIZE[1] / 2, w2c)
        views.append(View(name, camera, Path(name)))
    colors, every = np.full((case.points, 3), 128, np.uint8), tuple(range(case.views))
    return Scene(
        "street", Path("street"), tuple(views), points, colors, every, every, cache=Blank()
    )


def resident() -> dict[str, int]:
    """Memory of this process, bytes, by kind."""
    now = memory_of()
    return {kind: now[kind] for kind in ("RssAnon", "RssFile")}


def steps_of(state: TrainState) -> Iterator[float]:
    """Seconds of each step of the full training, which begins here."""
    phase = phases_of(state.context.config)[0]
    phase.begin(state)
    set_optimizer(state, phase.make_optimizer(state))
    while True:
        started = time.perf_counter()
        phase.step(state)
        state.progress.step += 1
        yield time.perf_counter() - started


def measure(case: Case) -> dict[str, object]:
    """Train in this process."""
    config = resolve_settings("max", None, {"train.steps": 8000, "levels.steps": 2000}).config
    with one_torch_thread():
        state = fresh_state(TrainContext(street(case), config, CpuRenderer(), FilePacker()))
        steps = steps_of(state)
        for _ in range(FIRST):
            next(steps)
        times, most = list[float](), dict.fromkeys(resident(), 0)
        for _ in range(STEPS):
            times.append(next(steps))
            most = {kind: max(most[kind], size) for kind, size in resident().items()}
        rows = row_parameters(state.model).values()
        return {
            **asdict(case),
            "anchors": len(state.model),
            "state_mib": round(12 * sum(p.numel() for p in rows) / MIB),
            "step_ms": round(1e3 * float(np.median(times)), 1),
            "mean_ms": round(1e3 * float(np.mean(times)), 1),
            "anon_mib": round(most["RssAnon"] / MIB),
            "file_mib": round(most["RssFile"] / MIB),
        }


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    chosen = [CASES[number] for number in options.only] or CASES
    os.environ.setdefault("OMP_NUM_THREADS", "2")
    context, rows = get_context("spawn"), list[dict[str, object]]()
    with ProcessPoolExecutor(1, mp_context=context, max_tasks_per_child=1) as pool:
        for case in chosen:
            rows.append(pool.submit(measure, case).result())
            print(rows[-1], flush=True)
    facts = machine()
    where = {"machine": facts.cpu, "torch": facts.torch, "commit": short_commit()}
    if not options.only:
        write_rows(CSV, [{**row, **where} for row in rows])
        print(f"wrote {CSV}")


if __name__ == "__main__":
    main()
