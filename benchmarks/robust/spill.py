"""Trainings below a limit of memory that what they hold exceeds, beside the same without a limit.

    OMP_NUM_THREADS=2 python -m benchmarks.robust.spill

A long street of points with small photos, of which each sees a stretch; `gsynopsis train` takes it
from its folder to a file: growth, joint levels, checkpoints, rounding and packing included. State
is the values of the anchors that it begins with, and Adam's two moments of them. Written to
docs/results/spill.csv; ends with an error if a limit changes a byte of the file.
"""

import hashlib
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from PIL import Image

from benchmarks.bench import RESULTS, RUNS, Row, machine, memory_of, short_commit, write_rows
from gsynopsis.pipeline.planning import plan_of
from gsynopsis.pipeline.training import Conduct, make_setup, resolve
from gsynopsis.scene.colmap_binary import write_binary
from gsynopsis.scene.colmap_layout import Pinhole, Pose, SparseModel
from gsynopsis.scene.scene import load_scene
from gsynopsis.training.plan import row_values

CSV = RESULTS / "spill.csv"
MIB = 2**20
SIZE = 160, 120
STATE_COPIES = 3
"""Of every value: itself and two moments."""


@dataclass(frozen=True)
class Case:
    """A street: its points and photos, rows of the codebook, steps, and GiB of the limit."""

    points: int
    views: int
    codebook: int
    steps: int
    level_steps: int
    limit: float


CASES = (Case(200_000, 100, 0, 100, 40, 0.5), Case(600_000, 200, 256, 100, 40, 0.5))


@dataclass(frozen=True)
class Options:
    """What to measure.

    Attributes:
        only: Numbers of the cases, from 0; nothing is written then.
    """

    only: tuple[int, ...] = ()


def make_street(case: Case, folder: Path) -> None:
    """Points in a long box in soft stripes, cameras along it, photos as of a wall in its middle."""
    rng, length = np.random.default_rng(0), float(case.views)
    points = rng.uniform(-1, 1, (case.points, 3)) * (length, 1, 1)
    colors = stripes(points[:, 0], points[:, 1])
    (folder / "images").mkdir(parents=True)
    right, down = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    right, down = (
        (3 / SIZE[0]) * (axis - half / 2) for axis, half in ((right, SIZE[0]), (down, SIZE[1]))
    )
    poses: list[Pose] = []
    for k in range(case.views):
        name = f"{k:05d}.png"
        place = 2.0 * k + 1 - length
        Image.fromarray(stripes(right + place, down)).save(folder / "images" / name)
        poses.append(Pose(name, 1, (1.0, 0.0, 0.0, 0.0), (-place, 0.0, 3.0)))
    lens = Pinhole(*SIZE, SIZE[0], SIZE[0], SIZE[0] / 2, SIZE[1] / 2)
    write_binary(folder / "sparse" / "0", SparseModel({1: lens}, tuple(poses), points, colors))


def stripes(x: NDArray[Any], y: NDArray[Any]) -> NDArray[np.uint8]:
    """Colours of places, […, 3]."""
    waves = [np.sin(9 * x), np.sin(7 * y), np.sin(5 * (x + y))]
    return (127 + 100 * np.stack(waves, axis=-1)).astype(np.uint8)


def measure(case: Case, scene: Path, out: Path, limit: float | None) -> Row:
    """The command in a process of its own, watched from here."""
    asked = settings(case)
    words = ["train", str(scene), "--out", str(out), "--quiet", "--no-evaluate"]
    words += ["--set", *(f"{name}={value}" for name, value in asked.items())]
    words += [] if limit is None else ["--max-memory", str(limit)]
    begun, before = time.monotonic(), getrusage(RUSAGE_CHILDREN)
    most = {"VmHWM": 0, "RssAnon": 0}  # the most it ever had, and what no file holds
    with subprocess.Popen([sys.executable, "-m", "gsynopsis", *words]) as process:
        while process.poll() is None:
            now = memory_of(process.pid)
            most = {kind: max(size, now.get(kind, 0)) for kind, size in most.items()}
            time.sleep(0.02)
    if process.returncode:
        raise SystemExit(f"spill.py: train ended with {process.returncode}")
    file, after = out / "scene.gsyn", getrusage(RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {
        "limit": limit or "",
        "seconds": round(time.monotonic() - begun, 1),
        "cpu_seconds": round(cpu, 1),
        "peak_mib": round(most["VmHWM"] / MIB),
        "anon_mib": round(most["RssAnon"] / MIB),
        "file_bytes": file.stat().st_size,
        "digest": hashlib.sha256(file.read_bytes()).hexdigest()[:16],
    }


def settings(case: Case) -> dict[str, object]:
    """Of preset `fast`, shortened."""
    steps = {"train.steps": case.steps, "levels.steps": case.level_steps}
    return {**steps, "model.voxel": 0.004, "model.codebook": case.codebook}


def state_of(case: Case, scene: Path) -> Row:
    """Anchors that a training begins with, and what they hold."""
    recipe = resolve("fast", load_scene(scene), settings(case))
    setup = make_setup(load_scene(scene), recipe.config, Conduct())
    anchors, values = plan_of(setup).anchors, row_values(recipe.config.model)
    return {"anchors": anchors, "state_mib": round(4 * STATE_COPIES * values * anchors / MIB)}


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    facts, rows = machine(), list[Row]()
    RUNS.mkdir(exist_ok=True)
    where = {"machine": facts.cpu, "torch": facts.torch, "commit": short_commit()}
    for number in options.only or range(len(CASES)):
        case = CASES[number]
        with tempfile.TemporaryDirectory(dir=RUNS) as root:
            folder = Path(root)
            make_street(case, folder / "street")
            facts_of = {**asdict(case), **state_of(case, folder / "street")}
            pair = [
                {
                    **facts_of,
                    **measure(case, folder / "street", folder / f"run{limit}", limit),
                    **where,
                }
                for limit in (None, case.limit)
            ]
            print(*pair, sep="\n", flush=True)
            rows += pair
            if pair[0]["digest"] != pair[1]["digest"]:
                raise SystemExit("spill.py: the files differ")
    if not options.only:
        write_rows(CSV, rows)
        print(f"wrote {CSV}")


if __name__ == "__main__":
    main()
