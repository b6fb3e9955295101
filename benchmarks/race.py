"""Held-out PSNR for time spent: this project's `train` and the prototype's, one after the other.

    python benchmarks/race.py --data ../shared/data --prototype ../shared/reference/prototype

Both train fox at a quarter of its size with all threads; nothing else should run. Times are wall
time of the whole command, reading photos and packing included, evaluating not.
"""

import json
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import torch
import tyro

from gsynopsis.evaluate.machine import this_machine
from marked_pages import put, short_commit
from prototype_step import build_trainer

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "results" / "speed.md"
PROTOTYPE = ("--feat", "free", "--its", "2400", "--factor", "4")


@dataclass(frozen=True)
class Options:
    """What to race.

    Attributes:
        data: Folder that holds the scene fox.
        prototype: Folder of the prototype.
        steps: Our steps of the full training; those of the levels are 5/3 of it.
    """

    data: Path = ROOT.parent / "shared" / "data"
    prototype: Path = ROOT.parent / "shared" / "reference" / "prototype"
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
        results = [prototype(options, Path(spare) / "a")]
        results += [ours(options, steps, Path(spare) / f"b{steps}") for steps in options.steps]
    lines = ["| fox at a quarter of its size | seconds | finest level, dB |", "|---|---|---|"]
    lines += [f"| {r.name} | {r.seconds:.0f} | {r.psnr:.2f} |" for r in results]
    machine = this_machine(torch.device("cpu"))
    note = f"{torch.get_num_threads()} threads, {machine.cpu}, commit {short_commit()}, seed 0."
    put(PAGE, "race.py", "\n".join([*lines, "", note]))
    print("\n".join(lines), note, f"wrote {PAGE}", sep="\n")


def prototype(options: Options, folder: Path) -> Result:
    """Build the prototype in a folder of its own and let it train."""
    here = build_trainer(options.prototype, options.data, folder)
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
    told = subprocess.run(
        [*run, "evaluate", str(folder), "--json", "--quiet"], check=True, capture_output=True
    )
    finest = json.loads(told.stdout)["levels"][-1]
    total = steps + round(steps * 5 / 3)
    return Result(f"ours, {total:,} steps, four levels", seconds, finest["psnr_full"])


if __name__ == "__main__":
    main()
