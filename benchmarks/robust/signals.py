"""Signals at random moments of `import`, `export`, `train --blocks` and `scene`.

    OMP_NUM_THREADS=1 python -m benchmarks.robust.signals --count 50
    python -m benchmarks.robust.signals --only import --count 5 --csv

Each command runs once to its end. Then it gets SIGINT, SIGTERM or SIGKILL at a random moment (one
that comes too late is not counted), and is repeated: it must end well, with the same bytes, and
leave no other names than the first time did. Of SIGINT and SIGTERM nothing half written may be left
at once, and one line is said.

All run on one processor: poses by several threads of pycolmap differ in their last bits from run
to run, without a signal as well.
"""

import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import tyro

from benchmarks.bench import RESULTS, put_row, short_commit
from benchmarks.robust.examples import gaussians
from gsynopsis.files import DRAFT
from gsynopsis.formats.writers.ply import ply_bytes
from gsynopsis.synthetic.make_scene import make_scene

KINDS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
PATIENCE = 600
"""Seconds that a command may take to end after a signal."""
SPLATS = 2_000
TABLE = RESULTS / "signals.csv"
VOLATILE = ("run.json", "scene.json", "plan.json")
"""Files that tell how long it took."""
Words = list[str]


@dataclass(frozen=True)
class Settings:
    """Options of the trial.

    Attributes:
        count: Signals for each command.
        only: Names of commands; all if empty.
        seed: Seed of moments and kinds.
        seconds: For each command, at most; 0 for no limit.
        csv: Put the rows into docs/results/signals.csv; those of other commands stay.
    """

    count: int = 50
    only: tuple[str, ...] = ()
    seed: int = 0
    seconds: float = 0.0
    csv: bool = False


@dataclass
class Told:
    """Counts of one command."""

    signals: int = 0
    ended_before: int = 0
    leftovers: int = 0
    other_bytes: int = 0
    failed: int = 0
    lines: int = 0
    trouble: list[str] = field(default_factory=list[str])

    @property
    def wrong(self) -> int:
        """All that may not happen."""
        return self.leftovers + self.other_bytes + self.failed + self.lines


def commands(root: Path) -> dict[str, Callable[[Path], Words]]:
    """Command lines that write below a folder; inputs are made below `root`."""
    ply = root / "splats.ply"
    ply.write_bytes(ply_bytes(gaussians(SPLATS)))
    file = root / "splats.gsyn"
    subprocess.run(line(["import", str(ply), "--out", str(file)]), check=True, capture_output=True)
    room = make_scene("room", root / "room", views=10, width=320, height=240, points=400)
    few = ["--features", "1024"]
    small = make_scene("room", root / "small", views=6, width=48, height=32, points=200)
    train = ["train", str(small), "--blocks", "2", "--steps", "20", "--levels.steps", "10"]
    train += ["--model.codebook", "0", "--levels", "joint", "--no-evaluate", "--quiet"]
    # Of its steps few, so that as many signals meet the other parts of an import.
    brief = ["--steps", "20", "--overwrite"]
    return {
        "import": lambda out: ["import", str(ply), "--out", str(out / "a.gsyn"), *brief],
        "export": lambda out: ["export", str(file), "--out", str(out / "a.ply"), "--overwrite"],
        "blocks": lambda out: [*train, "--out", str(out / "run")],
        "scene": lambda out: ["scene", str(room / "images"), str(out / "scene"), *few],
    }


def line(words: Words) -> Words:
    """A command in a process of its own."""
    return [sys.executable, "-m", "gsynopsis", *words]


def contents(folder: Path) -> dict[str, str]:
    """SHA-256 of all files by name."""
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {
        str(path.relative_to(folder)): ""
        if path.name in VOLATILE or path.suffix == ".safetensors"
        else hashlib.sha256(path.read_bytes()).hexdigest()
        for path in paths
    }


def drafts(folder: Path) -> list[str]:
    """Names of half-written files."""
    return [path.name for path in folder.rglob("*") if DRAFT.fullmatch(path.name)]


def finished(make: Callable[[Path], Words], out: Path) -> dict[str, str]:
    """Contents of a folder once a command has run to its end there."""
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    subprocess.run(line(make(out)), check=True, capture_output=True)
    return contents(out)


def in_one_line(said: bytes, code: int) -> bool:
    """True if a command that was stopped says so in one line, or did not come to say anything."""
    ours = [text for text in said.decode().splitlines() if text.startswith("gsynopsis: ")]
    return b"Traceback" not in said and b"***" not in said and (code < 0 or len(ours) == 1)


def store(name: str, told: Told) -> None:
    """Put a command's row into the table."""
    row = {"command": name, **asdict(told), "commit": short_commit()}
    del row["trouble"]
    put_row(TABLE, row, ("command", "commit"))


def interrupt(name: str, make: Callable[[Path], Words], root: Path, settings: Settings) -> Told:
    """All signals of a command."""
    told, moments = Told(), random.Random(f"{name} {settings.seed}")
    begun = time.monotonic()
    expected = finished(make, root / "whole")
    length = time.monotonic() - begun
    while told.signals < settings.count:
        if settings.seconds and time.monotonic() - begun > settings.seconds:
            break
        out = root / "interrupted"
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()
        kind = moments.choice(KINDS)
        child = subprocess.Popen(line(make(out)), stderr=subprocess.PIPE, stdout=subprocess.DEVNULL)
        try:
            child.wait(moments.uniform(0.1, 1.0) * length)
        except subprocess.TimeoutExpired:
            child.send_signal(kind)
        _, said = child.communicate(timeout=PATIENCE)
        told.ended_before += child.returncode == 0
        told.signals += child.returncode != 0
        where = f"{kind.name} {told.signals}"
        if kind != signal.SIGKILL and child.returncode:
            if not in_one_line(said, child.returncode):
                told.lines += 1
                told.trouble.append(f"{where}: {said.decode()[-300:]}")
            if left := drafts(out):
                told.leftovers += 1
                told.trouble.append(f"{where}: left {left}")
        again = subprocess.run(line(make(out)), capture_output=True, text=True)
        found = contents(out)
        told.failed += bool(again.returncode)
        told.leftovers += bool(drafts(out)) or found.keys() != expected.keys()
        told.other_bytes += any(found[n] != expected[n] for n in found.keys() & expected.keys())
        if again.returncode or found != expected:
            names = [n for n in {*found, *expected} if found.get(n) != expected.get(n)]
            told.trouble.append(f"{where}: {again.stderr[-300:]} {sorted(names)[:5]}")
            print(name, told.trouble[-1], file=sys.stderr, flush=True)
        if settings.csv:
            store(name, told)
    shutil.rmtree(root / "whole")
    return told


def main() -> int:
    settings, results = tyro.cli(Settings, description=__doc__), dict[str, Told]()
    # Commands ignore Ctrl-C if this process does, as jobs in the background do.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        for command, make in commands(root).items():
            if not settings.only or command in settings.only:
                results[command] = interrupt(command, make, root, settings)
                told = asdict(results[command])
                print(command, json.dumps(told), file=sys.stderr, flush=True)
    print(json.dumps({name: asdict(told) for name, told in results.items()}, indent=1))
    return int(any(told.wrong for told in results.values()))


if __name__ == "__main__":
    sys.exit(main())
