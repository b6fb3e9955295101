"""Cost of another busy process to a training, and times of an earlier version: ratios of one run.

    git worktree add runs/earlier 15fb74e && make -C runs/earlier install
    python -m benchmarks.train.threads --before runs/earlier/.venv/bin/python

Whole processes of `gsynopsis train` take turns, with nothing else running and beside one that never
sleeps, on the same processors and with no variable set that chooses threads. Nothing else should
run on the machine. Rows go to docs/results/threads.csv, a sentence into docs/results/speed.md.
"""

import hashlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import tyro

from benchmarks.bench import DATA, RESULTS, machine, put, short_commit, write_rows
from gsynopsis.container import encode, read_gsyn

PAGE, CSV = RESULTS / "speed.md", RESULTS / "threads.csv"
BUSY_BAR, QUIET_BAR = 1.6, 0.7
CHOOSING = ("OMP_", "GOMP_", "MKL_", "KMP_")
"""Prefixes of the variables that choose threads."""
BUSY = "import os; parent = os.getppid()\nwhile os.getppid() == parent: pass"
"""Program that never sleeps, and ends with its parent process, however that ended."""


@dataclass(frozen=True)
class Options:
    """Options of the timing.

    Attributes:
        data: Folder that holds the scene fox.
        before: Python of an installed earlier version; without it only this version is timed.
        scale: Divide the photos' width and height by this.
        steps: Steps of the full training; those of the levels are 5/3 of it.
        rounds: Number of turns of each.
        cores: Processors that all processes share.
    """

    data: Path = DATA
    before: Path | None = None
    scale: float = 4.0
    steps: int = 150
    rounds: int = 3
    cores: int = 2


@dataclass(frozen=True)
class Row:
    """One training.

    Attributes:
        version: `now` or `before`.
        beside: `nothing`, or `one busy process`.
        process_s: Seconds of the whole process: loading, training and packing.
        train_s: Seconds of training that it counted itself.
        sha256: Of its file without notes.
    """

    version: str
    beside: str
    process_s: float
    train_s: float
    sha256: str


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: options.cores])
    versions = {"now": Path(sys.executable)}
    if options.before:
        # Not resolved: the link's place tells Python its environment.
        versions["before"] = options.before.absolute()
    rows: list[Row] = []
    for _ in range(options.rounds):
        for version, python in versions.items():
            for beside in ("nothing", "one busy process"):
                with busy_process(beside != "nothing"):
                    rows.append(train(version, python, beside, options))
                print(rows[-1], flush=True)
    if len({(row.version, row.sha256) for row in rows}) > len(versions):
        raise SystemExit("threads.py: not all files of one version are the same bytes, notes aside")
    text = text_of(rows, options)
    if options.before:
        write_rows(CSV, [asdict(row) for row in rows])
        put(PAGE, __file__, text)
        print(f"wrote {CSV} and {PAGE}")
    print(text)


@contextmanager
def busy_process(wanted: bool) -> Generator[None]:
    """A process that never sleeps, for one `with` block; or none."""
    if not wanted:
        yield
        return
    with subprocess.Popen([sys.executable, "-c", BUSY]) as process:
        try:
            yield
        finally:
            process.kill()


def train(version: str, python: Path, beside: str, options: Options) -> Row:
    """Time one training, without what chooses threads in its environment."""
    kept = {name: text for name, text in os.environ.items() if not name.startswith(CHOOSING)}
    scene = options.data.absolute() / "fox"
    words = ["--scale", str(options.scale), "--steps", str(options.steps), "--quiet"]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        command = [python, "-m", "gsynopsis", "train", scene, "--out", out, *words]
        start = time.perf_counter()
        # From a folder of its own: Python looks for modules where it is started.
        subprocess.run([*command, "--no-evaluate"], env=kept, cwd=folder, check=True)
        seconds = time.perf_counter() - start
        counted: float = json.loads((out / "run.json").read_text())["train_seconds"]
        # Versions differ in what their files say of themselves, not in what was learnt.
        digest = hashlib.sha256(encode(replace(read_gsyn(out / "scene.gsyn"), meta={}))).hexdigest()
    return Row(version, beside, round(seconds, 2), round(counted, 2), digest)


def text_of(rows: list[Row], options: Options) -> str:
    """Medians of all turns, and medians of the ratios within each turn."""
    quiet, busy = column(rows, "now", "nothing"), column(rows, "now", "one busy process")
    parts = [timed("now", quiet, busy)]
    bars = f"beside a busy process at most {BUSY_BAR} times as long as with nothing else"
    if options.before:
        quiet_before = column(rows, "before", "nothing")
        busy_before = column(rows, "before", "one busy process")
        parts.append(timed("before", quiet_before, busy_before))
        shares = ratio(quiet, quiet_before), ratio(busy, busy_before)
        parts.append(f"now / before {shares[0]:.2f} alone, {shares[1]:.2f} beside")
        bars += f", and with nothing else at most {QUIET_BAR} of what the earlier version took"
    facts = machine()
    return (
        f"Whole process: {'; '.join(parts)}. fox at 1/{options.scale:g}, `--steps "
        f"{options.steps}`, {options.cores} cores of {facts.cpu}, medians of {options.rounds} "
        f"turns, commit {short_commit()}; all files of one version are the same bytes, notes "
        f"aside. Bars: {bars}."
    )


def column(rows: list[Row], version: str, beside: str) -> list[float]:
    """Seconds of one kind of process, in the order of turns."""
    return [row.process_s for row in rows if (row.version, row.beside) == (version, beside)]


def timed(name: str, quiet: list[float], busy: list[float]) -> str:
    """A version's seconds alone and beside a busy process, and their ratio."""
    alone, beside = statistics.median(quiet), statistics.median(busy)
    both = f"{name} {alone:.1f} s alone, {beside:.1f} s beside a busy one"
    return f"{both} ({ratio(busy, quiet):.2f})"


def ratio(over: list[float], under: list[float]) -> float:
    """Median of the ratios within each turn."""
    return statistics.median(a / b for a, b in zip(over, under, strict=True))


if __name__ == "__main__":
    main()
