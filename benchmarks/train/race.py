"""Held-out PSNR for time spent: this project's `train` and the prototype's, one after the other.

    python -m benchmarks.train.race

Both train fox at a quarter of its size with all threads; nothing else should run. Times are wall
time of the whole command, reading photos and packing included, evaluating not. Without the
prototype's folder nothing is run.
"""

import re
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import torch
import tyro

from benchmarks.bench import DATA, RESULTS, machine, prototype_in, put, short_commit
from benchmarks.train.prototype_step import build_trainer
from gsynopsis.pipeline.evaluation import evaluate

PAGE = RESULTS / "speed.md"
PROTOTYPE = ("--feat", "free", "--its", "2400", "--factor", "4")


@dataclass(frozen=True)
class Options:
    """What to race.

    Attributes:
        data: Folder that holds the scene fox.
        prototype: Folder of the prototype; by default ../shared/reference/prototype.
        steps: Our steps of the full training; those of the levels are 5/3 of it.
    """

    data: Path = DATA
    prototype: Path | None = None
    steps: tuple[int, ...] = (450, 600, 900)


@dataclass(frozen=True)
class Result:
    """One training: what it was, wall seconds and mean PSNR of the held-out views."""

    name: str
    seconds: float
    psnr: float


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    theirs = prototype_in(options.prototype, "train.py")
    if theirs is None:
        return
    with tempfile.TemporaryDirectory() as spare:
        results = [prototype(theirs, options.data, Path(spare) / "a")]
        results += [ours(options, steps, Path(spare) / f"b{steps}") for steps in options.steps]
    lines = ["| fox at a quarter of its size | seconds | finest level, dB |", "|---|---|---|"]
    lines += [f"| {r.name} | {r.seconds:.0f} | {r.psnr:.2f} |" for r in results]
    facts = machine()
    note = f"{torch.get_num_threads()} threads, {facts.cpu}, commit {short_commit()}, seed 0."
    put(PAGE, __file__, "\n".join([*lines, "", note]))
    print("\n".join(lines), note, f"wrote {PAGE}", sep="\n")


def prototype(theirs: Path, data: Path, folder: Path) -> Result:
    """Build the prototype in a folder of its own and let it train."""
    here = build_trainer(theirs, data, folder)
    command = [sys.executable, "train.py", *PROTOTYPE]
    start = time.perf_counter()
    done = subprocess.run(command, cwd=here, check=True, capture_output=True, text=True)
    seconds = time.perf_counter() - start
    found = re.findall(r"test ([\d.]+)", done.stdout)
    return Result(f"prototype, {' '.join(PROTOTYPE[:4])}", seconds, float(found[-1]))


def ours(options: Options, steps: int, folder: Path) -> Result:
    """All four levels in one file; the finest is compared."""
    run = [sys.executable, "-m", "gsynopsis"]
    words = ["train", str(options.data / "fox"), "--out", str(folder), "--scale", "4", "--quiet"]
    start = time.perf_counter()
    subprocess.run([*run, *words, "--steps", str(steps), "--no-evaluate"], check=True)
    seconds = time.perf_counter() - start
    finest = evaluate(folder).levels[-1].quality
    total = steps + round(steps * 5 / 3)
    return Result(f"ours, {total:,} steps, four levels", seconds, finest.psnr_full)


if __name__ == "__main__":
    main()
