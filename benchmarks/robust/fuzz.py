"""Seeded mutations of .gsyn files through every command and both decoders: equal verdicts.

    python -m benchmarks.robust.fuzz                 # 100,000 mutants, some hours on one core
    python -m benchmarks.robust.fuzz --count 2000 --every 8

A mutant is refused by all that read it or by none: by Python's decoder and the viewer's with the
same class of error, and by each command with exit code 2 and one line. A file whose checksums do
not fit is accepted by nobody. No command may end otherwise, take over 10 seconds of the processor,
or make the process grow beyond 512 MiB over what it takes before the first mutant: beyond that an
allocation fails. The picture of `stream`'s timeline, the same for all files, is left out.
"""

import json
import resource
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from types import FrameType
from unittest.mock import patch

import tyro

from benchmarks.bench import ROOT
from benchmarks.robust.commands import STOPPED, Hang, commands, outcome
from benchmarks.robust.mutants import Mutant, mutants, seeds
from benchmarks.viewer.node import NODE, VIEWER
from gsynopsis.container import decode
from gsynopsis.errors import FormatError

HANG_SECONDS, WAIT_SECONDS = 10, 300
MEMORY_CAP = 512 << 20
"""Address space above what the process uses before the first mutant, bytes."""
BATCH = 500
"""Mutants that the viewer's decoder gets at once."""
ACCEPTED = "accepted"
SPEED = "time_s,mbit_per_s\n0,20\n100,20\n"


@dataclass(frozen=True)
class Options:
    """What to run.

    Attributes:
        count: Mutants in all.
        every: Commands get one in so many of them, decoders get all.
        seed: Of the mutants.
        seconds: Stop after this long; 0 for no limit.
        json: Print JSON.
    """

    count: int = 100_000
    every: int = 1
    seed: int = 0
    seconds: float = 0.0
    json: bool = False


@dataclass
class Tally:
    """What happened; `trouble` has the first of what may not."""

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

    def note(self, number: int, what: str) -> None:
        """Remember what happened to a mutant."""
        if len(self.trouble) < 20:
            self.trouble.append(f"mutant {number}: {what}")


class Fuzzer:
    """Runs mutants in a folder of its own and counts."""

    def __init__(self, folder: Path, options: Options) -> None:
        self.tally, self.options = Tally(), options
        self.file, self.bundle, out = folder / "x.gsyn", folder / "mutants", folder / "out"
        out.mkdir()
        trace = folder / "line.csv"
        trace.write_text(SPEED)
        self.commands = commands(self.file, out, trace)

    def verdict(self, number: int, mutant: Mutant) -> str:
        """What Python's decoder says: accepted, or the class of the refusal."""
        try:
            decode(mutant.data, "mutant")
        except FormatError as error:
            return type(error).__name__
        if mutant.silent:
            self.tally.silent_accepts += 1
            self.tally.note(number, "accepted with wrong checksums")
        self.tally.accepted += 1
        return ACCEPTED

    def run_commands(self, number: int, mutant: Mutant, verdict: str) -> None:
        """All commands on one mutant."""
        self.file.write_bytes(mutant.data)
        wanted = 0 if verdict == ACCEPTED else 2
        for name, command in self.commands.items():
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
                self.tally.note(number, f"{name}: {found.trouble}")
            elif found.code != wanted:
                self.tally.disagreements += 1
                self.tally.note(number, f"{name}: code {found.code} of a file that is {verdict}")

    def compare(self, first: int, batch: list[Mutant], verdicts: list[str]) -> None:
        """The viewer's decoder on a batch of mutants, the first of which has a number."""
        if NODE is None:
            return
        self.bundle.write_bytes(b"".join(struct.pack("<I", len(m.data)) + m.data for m in batch))
        script = ROOT / "benchmarks" / "viewer" / "verdicts.mjs"
        line = [NODE, str(script), str(VIEWER), str(self.bundle)]
        done = subprocess.run(line, capture_output=True, check=True, preexec_fn=uncap_memory)
        answers = json.loads(done.stdout)
        self.tally.viewer += len(answers)
        for number, (answer, verdict) in enumerate(zip(answers, verdicts, strict=True), first):
            if answer != verdict:
                self.tally.disagreements += 1
                self.tally.note(number, f"Python: {verdict}, viewer: {answer}")

    def run(self) -> Tally:
        """All mutants, batch by batch."""
        options, tally = self.options, self.tally
        before, started = peak_mib(), time.perf_counter()
        for batch in batches(options):
            verdicts: list[str] = []
            for number, mutant in enumerate(batch, tally.mutants):
                verdicts.append(self.verdict(number, mutant))
                if number % options.every == 0:
                    self.run_commands(number, mutant, verdicts[-1])
            self.compare(tally.mutants, batch, verdicts)
            tally.mutants += len(batch)
            tally.seconds = time.perf_counter() - started
            tally.growth_mib = peak_mib() - before
            if not options.json:
                print(vars(tally), file=sys.stderr, flush=True)
            if options.seconds and tally.seconds > options.seconds:
                break
        return tally


def batches(options: Options) -> Iterator[list[Mutant]]:
    stream = islice(mutants(options.seed), options.count)
    while batch := list(islice(stream, BATCH)):
        yield batch


def peak_mib() -> float:
    """The most memory that the process has had, MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def on_alarm(number: int, frame: FrameType | None) -> None:
    raise Hang


def cap_memory() -> None:
    """No more than `MEMORY_CAP` beyond what is mapped now."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY_CAP
    resource.setrlimit(resource.RLIMIT_AS, (limit, resource.getrlimit(resource.RLIMIT_AS)[1]))


def uncap_memory() -> None:
    """For a process of another program, which maps as it likes."""
    most = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def main() -> int:
    options = tyro.cli(Options, description=__doc__)
    for timer in (signal.SIGPROF, signal.SIGALRM):
        signal.signal(timer, on_alarm)
    plots = "gsynopsis.evaluation.timelines.plot_timeline"
    with tempfile.TemporaryDirectory() as folder, patch(plots, lambda timeline, out: out):
        fuzzer = Fuzzer(Path(folder), options)
        # Imports, and the memory that they take, come before the cap.
        for data in seeds():
            fuzzer.run_commands(-1, Mutant(data, False), ACCEPTED)
        if sys.platform == "linux":
            cap_memory()
        fuzzer.tally.commands = 0
        tally = fuzzer.run()
    print(json.dumps(vars(tally)) if options.json else f"{vars(tally)}")
    return int(bool(tally.failed))


if __name__ == "__main__":
    sys.exit(main())
