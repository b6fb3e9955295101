"""Held-out PSNR for time spent: `train` with several numbers of steps, one after the other.

    python -m benchmarks.train.time_to_quality

Fox at a quarter of its size with all threads; nothing else should run. Times are wall time of the
whole command, reading photos and packing included, evaluating not.
"""

import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import torch
import tyro

from benchmarks.bench import DATA, RESULTS, machine, put, short_commit
from gsynopsis.jobs.evaluate import evaluate

PAGE = RESULTS / "speed.md"


@dataclass(frozen=True)
class Options:
    """Trainings to time.

    Attributes:
        data: Folder that holds the scene fox.
        steps: Steps of the full training; those of the levels are 5/3 of it.
    """

    data: Path = DATA
    steps: tuple[int, ...] = (450, 600, 900)


@dataclass(frozen=True)
class Result:
    """One training: what it was, wall seconds and mean PSNR of the held-out views."""

    name: str
    seconds: float
    psnr: float


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    with tempfile.TemporaryDirectory() as spare:
        results = [trained(options, steps, Path(spare) / str(steps)) for steps in options.steps]
    lines = ["| fox at a quarter of its size | seconds | finest level, dB |", "|---|---|---|"]
    lines += [f"| {r.name} | {r.seconds:.0f} | {r.psnr:.2f} |" for r in results]
    facts = machine()
    note = f"{torch.get_num_threads()} threads, {facts.cpu}, commit {short_commit()}, seed 0."
    put(PAGE, __file__, "\n".join([*lines, "", note]))
    print("\n".join(lines), note, f"wrote {PAGE}", sep="\n")


def trained(options: Options, steps: int, folder: Path) -> Result:
    """All four levels in one file; the finest is compared."""
    run = [sys.executable, "-m", "gsynopsis"]
    words = ["train", str(options.data / "fox"), "--out", str(folder), "--scale", "4", "--quiet"]
    start = time.perf_counter()
    subprocess.run([*run, *words, "--steps", str(steps), "--no-evaluate"], check=True)
    seconds = time.perf_counter() - start
    finest = evaluate(folder).levels[-1].quality
    total = steps + round(steps * 5 / 3)
    return Result(f"{total:,} steps, four levels", seconds, finest.psnr_full)


if __name__ == "__main__":
    main()
