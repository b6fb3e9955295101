"""Steps of a training whose views see little of it: all anchors moved, or those that are read.

    OMP_NUM_THREADS=2 python -m benchmarks.robust.lazy

A long street of points, of which each camera sees a stretch. Each row is a process of its own: the
time of a step, the memory after it, and a digest of all rows after the first steps, which must be
one for both ways. Written to docs/results/lazy.csv.
"""

import hashlib
import os
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Literal

import numpy as np
import tyro

from benchmarks.bench import RESULTS, machine, memory_of, short_commit, write_rows
from benchmarks.robust.memory import Blank
from gsynopsis._native.threads import one_torch_thread
from gsynopsis.config import resolve_settings
from gsynopsis.pipeline.packing import FilePacker
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.scene import Scene
from gsynopsis.scene.views import View
from gsynopsis.training.parameters import row_parameters
from gsynopsis.training.run import phases_of
from gsynopsis.training.state import Setup, TrainState, fresh_state

CSV = RESULTS / "lazy.csv"
MIB = 2**20
SIZE = 160, 120
FIRST = 12
"""Steps before the digest; they are not timed, as bounds are loose in the first of them."""
Way = Literal["dense", "lazy"]


@dataclass(frozen=True)
class Case:
    """A street.

    Attributes:
        points: In it.
        views: Along it, each of which sees about three shares of it.
        steps: That are timed.
    """

    points: int
    views: int
    steps: int


CASES = (
    Case(20_000, 4, 40),
    Case(100_000, 8, 24),
    Case(100_000, 40, 60),
    Case(400_000, 40, 60),
    Case(400_000, 160, 160),
)
LARGE = Case(2_000_000, 800, 240)
"""Its values and moments are 1.4 GiB."""


@dataclass(frozen=True)
class Options:
    """What to measure.

    Attributes:
        only: Numbers of the cases, from 0; the large one is the last.
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


def digest(state: TrainState) -> str:
    """Of all rows, after they were caught up."""
    found = hashlib.sha256()
    state.settle()
    for parameter in row_parameters(state.model).values():
        found.update(parameter.detach().numpy().data)
    return found.hexdigest()[:16]


def steps_of(state: TrainState) -> Iterator[float]:
    """Seconds of each step of the full training, which begins here."""
    phase = phases_of(state.setup.config)[0]
    phase.begin(state)
    state.start(phase.make_optimiser(state))
    while True:
        started = time.perf_counter()
        phase.step(state)
        state.cursor.step += 1
        yield time.perf_counter() - started


def measure(case: Case, way: Way) -> dict[str, object]:
    """Train in this process."""
    config = resolve_settings("ours", None, {"train.steps": 8000, "levels.steps": 2000}).config
    with one_torch_thread():
        setup = Setup(street(case), config, CpuRenderer(), FilePacker(), lazy=way == "lazy")
        state = fresh_state(setup)
        steps = steps_of(state)
        for _ in range(FIRST):
            next(steps)
        found = digest(state)
        times, most = list[float](), dict.fromkeys(resident(), 0)
        for _ in range(min(case.steps, 24) if way == "dense" else case.steps):
            times.append(next(steps))
            most = {kind: max(most[kind], size) for kind, size in resident().items()}
        started = time.perf_counter()
        state.settle()
        settled = time.perf_counter() - started
        rows = row_parameters(state.model).values()
        return {
            **asdict(case),
            "way": way,
            "anchors": len(state.model),
            "state_mib": round(12 * sum(p.numel() for p in rows) / MIB),
            "step_ms": round(1e3 * float(np.median(times)), 1),
            "mean_ms": round(1e3 * float(np.mean(times)), 1),
            "settle_ms": round(1e3 * settled, 1),
            "anon_mib": round(most["RssAnon"] / MIB),
            "file_mib": round(most["RssFile"] / MIB),
            "digest": found,
        }


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    cases = (*CASES, LARGE)
    chosen = [cases[number] for number in options.only] or cases
    os.environ.setdefault("OMP_NUM_THREADS", "2")
    context, rows = get_context("spawn"), list[dict[str, object]]()
    with ProcessPoolExecutor(1, mp_context=context, max_tasks_per_child=1) as pool:
        for case in chosen:
            ways: tuple[Way, ...] = ("dense", "lazy")
            of_case = [pool.submit(measure, case, way).result() for way in ways]
            rows += of_case
            print(*of_case, sep="\n", flush=True)
            if len({row["digest"] for row in of_case}) > 1:
                raise SystemExit("lazy.py: the ways differ")
    facts = machine()
    where = {"machine": facts.cpu, "torch": facts.torch, "commit": short_commit()}
    if not options.only:
        write_rows(CSV, [{**row, **where} for row in rows])
        print(f"wrote {CSV}")


if __name__ == "__main__":
    main()
