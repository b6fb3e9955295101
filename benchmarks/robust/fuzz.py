"""Seeded mutations of .gsyn files through every command and both decoders: equal verdicts.

    python -m benchmarks.robust.fuzz --jobs 2 --log shares.jsonl   # 100,000 mutants
    python -m benchmarks.robust.fuzz --count 2000 --every 8

    python -m benchmarks.robust.fuzz --only export --log exports.jsonl

A mutant is refused by all readers or by none: by Python's decoder and the viewer's with the same
class of error, and by each command with exit code 2 and one line. A file with wrong checksums is
accepted by none. No command may end otherwise, take over 10 seconds of the processor, or make the
process grow beyond 512 MiB over its size before the first mutant: beyond that an allocation fails.
The image of `stream`'s timeline, the same for all files, is left out. `export` may also refuse a
valid file, one whose level shows nothing from anywhere.

Mutants come in shares, each from a seed of its own, so that idle processes can take them. Shares in
the log are not run again: a run that was stopped goes on where it was.
"""

import gc
import json
import multiprocessing
import resource
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import asdict, dataclass, field
from itertools import islice
from pathlib import Path
from types import FrameType
from typing import Any
from unittest.mock import patch

import tyro

from benchmarks.bench import ROOT
from benchmarks.robust.commands import STOPPED, Hang, commands, outcome
from benchmarks.robust.mutants import Mutant, mutants, seeds
from benchmarks.viewer.node import INSTALLED, NODE, standalone
from gsynopsis.container import decode
from gsynopsis.errors import FormatError

HANG_SECONDS, WAIT_SECONDS = 10, 300
MEMORY_CAP = 512 << 20
"""Address space above what the process uses before the first mutant, bytes."""
SHARE = 500
"""Mutants of one seed; the viewer's decoder gets them at once."""
ACCEPTED = "accepted"
IN_MEMORY = Path("/dev/shm")
"""A file system without a disk."""
SPEED = "time_s,mbit_per_s\n0,20\n100,20\n"
BAKED_FROM = 8
"""Cameras from which `export` bakes a level, which usually are 64."""
MAY_REFUSE = ("export",)
"""Commands that need more of a file than that it is valid."""
TROUBLES = 20
"""Number of failures that a run prints; all are counted."""


@dataclass(frozen=True)
class Options:
    """Options of a run.

    Attributes:
        count: Mutants in all.
        every: Commands get one mutant in this many, decoders get all.
        seed: Seed of the mutants.
        first: Number of the first share.
        only: Name of the one command to run; all if empty.
        jobs: Processes.
        seconds: Begin no further share after this long; 0 for no limit.
        log: A JSON line for each finished share; shares in it are not run again.
        json: Print JSON.
    """

    count: int = 100_000
    every: int = 1
    seed: int = 0
    first: int = 0
    only: str = ""
    jobs: int = 1
    seconds: float = 0.0
    log: Path | None = None
    json: bool = False


@dataclass(frozen=True)
class Share:
    """A part of the mutants: `count` of those that the seeds `seed` and `number` give."""

    seed: int
    number: int
    count: int
    every: int
    only: str = ""


@dataclass
class Tally:
    """Counts of a share; `trouble` has the first failures."""

    mutants: int = 0
    accepted: int = 0
    viewer: int = 0
    commands: int = 0
    silent_accepts: int = 0
    disagreements: int = 0
    tracebacks: int = 0
    hangs: int = 0
    slowest_s: float = 0.0
    growth_mib: float = 0.0
    seconds: float = 0.0
    trouble: list[str] = field(default_factory=list[str])

    @property
    def failed(self) -> int:
        """All that may not happen."""
        return self.silent_accepts + self.disagreements + self.tracebacks + self.hangs

    def add(self, other: "Tally") -> None:
        """Count what happened in another share as well."""
        for name, value in vars(other).items():
            mine = getattr(self, name)
            peak = name in ("slowest_s", "growth_mib")
            setattr(self, name, max(mine, value) if peak else mine + value)
        del self.trouble[TROUBLES:]


class Fuzzer:
    """Runs mutants in a folder of its own and counts."""

    def __init__(self, folder: Path) -> None:
        self.tally, self.share = Tally(), Share(0, 0, 0, 1)
        self.file, self.bundle, out = folder / "x.gsyn", folder / "mutants", folder / "out"
        out.mkdir()
        trace = folder / "line.csv"
        trace.write_text(SPEED)
        self.commands = commands(self.file, out, trace)
        # Imports, and the memory that they take, come before the cap.
        for data in seeds():
            self.run_commands(-1, Mutant(data, False), ACCEPTED)
        if sys.platform == "linux":
            cap_memory()
        self.before = peak_mib()

    def note(self, number: int, what: str) -> None:
        """Remember what happened to a mutant."""
        if len(self.tally.trouble) < TROUBLES:
            self.tally.trouble.append(f"share {self.share.number}, mutant {number}: {what}")

    def verdict(self, number: int, mutant: Mutant) -> str:
        """Verdict of Python's decoder: accepted, or the class of the refusal."""
        try:
            decode(mutant.data, "mutant")
        except FormatError as error:
            return type(error).__name__
        if mutant.silent:
            self.tally.silent_accepts += 1
            self.note(number, "accepted with wrong checksums")
        self.tally.accepted += 1
        return ACCEPTED

    def run_commands(self, number: int, mutant: Mutant, verdict: str) -> None:
        """All commands on one mutant."""
        self.file.write_bytes(mutant.data)
        wanted = 0 if verdict == ACCEPTED else 2
        for name, command in self.commands.items():
            if self.share.only not in ("", name):
                continue
            # Of the processor, so that a machine's other work is no hang; a wait that uses none is.
            started = time.process_time()
            signal.setitimer(signal.ITIMER_PROF, HANG_SECONDS)
            signal.alarm(WAIT_SECONDS)
            found = outcome(command)
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.alarm(0)
            took = time.process_time() - started
            self.tally.commands += 1
            self.tally.slowest_s = max(self.tally.slowest_s, took)
            if found.trouble:
                hang = found.trouble == STOPPED
                self.tally.hangs += hang
                self.tally.tracebacks += not hang
                self.note(number, f"{name}: {found.trouble}")
            elif found.code != wanted and not (name in MAY_REFUSE and found.code == 2):
                self.tally.disagreements += 1
                self.note(number, f"{name}: code {found.code} of a file that is {verdict}")

    def compare(self, batch: list[Mutant], verdicts: list[str]) -> None:
        """The viewer's decoder on all mutants of a share."""
        if NODE is None or not INSTALLED:
            return
        self.bundle.write_bytes(b"".join(struct.pack("<I", len(m.data)) + m.data for m in batch))
        script = ROOT / "benchmarks" / "viewer" / "verdicts.mjs"
        line = [NODE, str(script), str(standalone()), str(self.bundle)]
        done = subprocess.run(line, capture_output=True, check=True, preexec_fn=uncap_memory)
        answers = json.loads(done.stdout)
        self.tally.viewer += len(answers)
        for number, (answer, verdict) in enumerate(zip(answers, verdicts, strict=True)):
            if answer != verdict:
                self.tally.disagreements += 1
                self.note(number, f"Python: {verdict}, viewer: {answer}")

    def run(self, share: Share) -> Tally:
        """All mutants of a share."""
        self.tally, self.share, started = Tally(), share, time.perf_counter()
        batch = list(islice(mutants(share.seed, share.number), share.count))
        verdicts: list[str] = []
        for number, mutant in enumerate(batch):
            verdicts.append(self.verdict(number, mutant))
            if number % share.every == 0:
                self.run_commands(number, mutant, verdicts[-1])
        self.compare(batch, verdicts)
        self.tally.mutants = len(batch)
        self.tally.seconds = time.perf_counter() - started
        self.tally.growth_mib = peak_mib() - self.before
        return self.tally


def folder_in_memory() -> tempfile.TemporaryDirectory[str]:
    """A folder for the time of a run, in memory where it can be, as each file waits for a disk."""
    return tempfile.TemporaryDirectory(dir=IN_MEMORY if IN_MEMORY.is_dir() else None)


def begin(folder: str) -> None:
    """Make a process ready to run shares."""
    for timer in (signal.SIGPROF, signal.SIGALRM):
        signal.signal(timer, on_alarm)
    plots = "gsynopsis.playback.plots.plot_timeline"
    patch(plots, lambda timeline, out: out).start()
    # A third of the time would be tyro's: command lines are the same for every mutant.
    patch("tyro.cli", parsed_once(tyro.cli)).start()
    # Half of the rest would be renderings, each like the other.
    patch("gsynopsis.jobs.export.ORBIT", BAKED_FROM).start()
    global _fuzzer
    _fuzzer = Fuzzer(Path(tempfile.mkdtemp(dir=folder)))
    gc.collect()
    gc.freeze()


def parsed_once(parse: Callable[..., Any]) -> Callable[..., Any]:
    """The same function, which remembers what it made of words."""
    known: dict[tuple[Any, tuple[str, ...]], Any] = {}

    def remembered(kind: Any, *, args: Sequence[str], **options: Any) -> Any:
        key = kind, tuple(args)
        if key not in known:
            known[key] = parse(kind, args=args, **options)
        return known[key]

    return remembered


_fuzzer: Fuzzer | None = None
"""Fuzzer of this process, once `begin` has made it."""


def run_share(share: Share) -> Tally:
    """Run a share in a process that is ready."""
    assert _fuzzer is not None
    return _fuzzer.run(share)


def shares_of(options: Options) -> Iterator[Share]:
    """All shares; the last one may be smaller."""
    for number, start in enumerate(range(0, options.count, SHARE), options.first):
        count = min(SHARE, options.count - start)
        yield Share(options.seed, number, count, options.every, options.only)


def finished(log: Path | None) -> dict[Share, Tally]:
    """Finished shares of a log; its last line may be cut off, of a run that was killed."""
    found: dict[Share, Tally] = {}
    for line in log.read_text("utf-8").splitlines() if log and log.exists() else ():
        try:
            share, tally = json.loads(line)
        except ValueError:
            continue
        found[Share(**share)] = Tally(**tally)
    return found


def run(options: Options, folder: str) -> Iterator[tuple[Share, Tally]]:
    """Shares as they are finished, those of the log first."""
    known, started = finished(options.log), time.monotonic()
    shares = list(shares_of(options))
    yield from ((share, known[share]) for share in shares if share in known)
    todo = iter([share for share in shares if share not in known])
    context, working = multiprocessing.get_context("spawn"), dict[Future[Tally], Share]()
    with ProcessPoolExecutor(options.jobs, context, begin, (folder,)) as pool:
        while True:
            late = options.seconds and time.monotonic() - started > options.seconds
            for share in islice(todo, 0 if late else options.jobs - len(working)):
                working[pool.submit(run_share, share)] = share
            if not working:
                return
            for done in wait(working, return_when=FIRST_COMPLETED).done:
                share, tally = working.pop(done), done.result()
                if options.log:
                    with options.log.open("a", encoding="utf-8") as file:
                        print(json.dumps([asdict(share), asdict(tally)]), file=file)
                yield share, tally


def peak_mib() -> float:
    """The most memory that the process has had, MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def on_alarm(number: int, frame: FrameType | None) -> None:
    raise Hang


def cap_memory() -> None:
    """Limit memory to `MEMORY_CAP` beyond what is mapped now."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY_CAP
    resource.setrlimit(resource.RLIMIT_AS, (limit, resource.getrlimit(resource.RLIMIT_AS)[1]))


def uncap_memory() -> None:
    """For a process of another program, which maps as it likes."""
    most = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def main() -> int:
    options, total = tyro.cli(Options, description=__doc__), Tally()
    if INSTALLED:
        standalone()  # built before memory is capped, which a build would not survive
    with folder_in_memory() as folder:
        for _, tally in run(options, folder):
            total.add(tally)
            if not options.json:
                print(vars(total), file=sys.stderr, flush=True)
    print(json.dumps(vars(total)) if options.json else f"{vars(total)}")
    return int(bool(total.failed))


if __name__ == "__main__":
    sys.exit(main())
