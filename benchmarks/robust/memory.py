"""Peak memory of training on the CPU against the model of `resources/estimate.py`.

    OMP_NUM_THREADS=1 python -m benchmarks.robust.memory

Each row is a process of its own that trains a few steps, growth and joint levels included, on
points in a box which every camera sees whole. Rows and fit are written to docs/results/memory.csv.
"""

import os
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import torch
import tyro
from numpy.typing import NDArray

from benchmarks.bench import CPU, RESULTS, machine, memory_of, short_commit, write_rows
from gsynopsis.config import Config, resolve_settings
from gsynopsis.jobs.write_file import FilePacker
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.resources import estimate as plan
from gsynopsis.scene.camera import STILL, Camera, Shift
from gsynopsis.scene.photos import AS_STORED, PhotoForm
from gsynopsis.scene.scene import PhotoCache, Scene
from gsynopsis.scene.views import View
from gsynopsis.training.context import TrainContext
from gsynopsis.training.distributed.process_group import ProcessGroup
from gsynopsis.training.loop import open_state, run_training
from gsynopsis.training.observer import Silent

CSV = RESULTS / "memory.csv"
VIEWS = 4


@dataclass(frozen=True)
class Case:
    """One training."""

    points: int
    width: int
    height: int
    slots: int
    codebook: int
    batch: int = 1


CASES = (
    Case(300, 64, 48, 10, 64),
    Case(20_000, 64, 48, 10, 64),
    Case(60_000, 64, 48, 10, 64),
    Case(20_000, 64, 48, 10, 256),
    Case(60_000, 64, 48, 10, 256),
    Case(20_000, 64, 48, 4, 64),
    Case(60_000, 64, 48, 4, 64),
    Case(20_000, 64, 48, 10, 0),
    Case(60_000, 64, 48, 4, 0),
    Case(300, 800, 600, 10, 64),
    Case(20_000, 800, 600, 10, 64),
    Case(20_000, 1600, 1200, 10, 64),
    Case(60_000, 800, 600, 10, 256, 2),
)


@dataclass(frozen=True)
class Options:
    """Options of the measurement.

    Attributes:
        only: Numbers of the rows to measure, from 0; nothing is fitted or written then.
    """

    only: tuple[int, ...] = ()


class Blank(PhotoCache):
    """Photos of one colour that take as much memory as any, but no disk."""

    def get(
        self, path: Path, factor: float, shift: Shift = STILL, form: PhotoForm = AS_STORED
    ) -> NDArray[np.uint8]:
        """A new grey image for each view, then the same one."""
        width, height = map(int, path.stem.split("x"))
        key = (path, factor, shift, form)
        if key not in self._images:
            self._images[key] = np.full((height, width, 3), 128, np.uint8)
        return self._images[key]


def make(case: Case) -> Scene:
    """Points in a box, cameras on a ring that see all of it."""
    points = np.random.default_rng(0).uniform(-1, 1, (case.points, 3))
    views: list[View] = []
    for k in range(VIEWS):
        angle = 2 * np.pi * k / VIEWS
        sine, cosine = np.sin(angle), np.cos(angle)
        w2c = np.eye(4)
        w2c[:3, :3] = [[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]]
        w2c[2, 3] = 5
        size = case.width, case.height
        camera = Camera(*size, 0.9 * size[0], 0.9 * size[0], size[0] / 2, size[1] / 2, w2c)
        name = f"{case.width}x{case.height}.{k}"
        views.append(View(name, camera, Path(name)))
    colors = np.full((case.points, 3), 128, np.uint8)
    every = tuple(range(VIEWS))
    return Scene("box", Path("box"), tuple(views), points, colors, every, every, cache=Blank())


def settings(case: Case) -> Config:
    """Our model, shortly trained, with an adjustment of anchors that adds none."""
    asked = {
        "model.slots": case.slots,
        "model.codebook": case.codebook,
        "train.steps": 8,
        "train.batch": case.batch,
        "train.growth.until": 1.0,
        "train.growth.every": 3,
        "train.growth.threshold": 1e9,
        "levels.steps": 4,
    }
    return resolve_settings("max", None, asked).config


def measure(case: Case) -> dict[str, object]:
    """Train in this process; peak resident memory and what the plan says."""
    torch.set_num_threads(1)
    scene, config = make(case), settings(case)
    said = plan.make_plan(scene, config, CPU, ProcessGroup())
    idle = peak()
    context = TrainContext(scene, config, CpuRenderer(), FilePacker())
    with tempfile.TemporaryDirectory() as folder:
        state = open_state(context, Path(folder), Silent())
        run_training(state, Path(folder), Silent(), lambda: False)
    return {
        **asdict(case),
        "anchors": said.anchors,
        "idle_bytes": idle,
        "peak_bytes": peak(),
        "planned_bytes": said.start_bytes,
        "ratio": round(said.start_bytes / peak(), 3),
    }


def peak() -> int:
    """Peak resident memory of this process alone, bytes."""
    found = memory_of().get("VmHWM")
    if found is None:
        raise SystemExit("memory.py: needs /proc/self/status")
    return found


def fit(rows: list[dict[str, object]]) -> None:
    """Least squares over what the model does not know by itself; printed beside its constants."""
    table, rest = [], []
    for row, case in zip(rows, CASES, strict=True):
        count = float(str(row["anchors"]))
        codes = count * case.codebook
        table.append([1, count, count * case.slots, codes, case.width * case.height])
        own = replace_constants(row, case)
        rest.append(float(str(row["peak_bytes"])) - own)
    # Relative: a miss of 10 % counts the same for a small training and for a large one.
    weights = 1 / np.array([float(str(row["peak_bytes"])) for row in rows])
    found, *_ = np.linalg.lstsq(np.array(table) * weights[:, None], np.array(rest) * weights)
    names = ("PROCESS_BYTES", "ANCHOR_BYTES", "SLOT_BYTES", "CODE_BYTES", "PIXEL_BYTES")
    for name, value in zip(names, found, strict=True):
        print(f"{name}: fitted {value:,.0f}, in use {getattr(plan, name):,}")


def replace_constants(row: dict[str, object], case: Case) -> float:
    """The exact part of the plan: its value with the fitted constants at zero."""
    count = float(str(row["anchors"]))
    fitted = plan.PROCESS_BYTES + plan.PIXEL_BYTES * case.width * case.height
    per_anchor = plan.ANCHOR_BYTES + plan.SLOT_BYTES * case.slots + plan.CODE_BYTES * case.codebook
    return float(str(row["planned_bytes"])) - fitted - count * per_anchor


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    cases = [CASES[number] for number in options.only] or CASES
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    context = get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context, max_tasks_per_child=1) as pool:
        rows: list[dict[str, object]] = []
        for row in pool.map(measure, cases):
            rows.append(row)
            print(row, flush=True)
    if options.only:
        return
    fit(rows)
    facts = machine()
    where = {"machine": facts.cpu, "torch": facts.torch, "commit": short_commit()}
    write_rows(CSV, [{**row, **where} for row in rows])
    print(f"wrote {CSV}")


if __name__ == "__main__":
    main()
