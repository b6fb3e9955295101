"""Spoilt inputs through every reader of other people's files: a result or one line, in bounds.

    OMP_NUM_THREADS=1 python -m benchmarks.robust.doors               # 20,000 for each door
    python -m benchmarks.robust.doors --only record checkpoint-full --count 500
    python -m benchmarks.robust.doors --seconds 2                     # at most for each door

One file of a small valid example is spoilt (`spoilt.py`) and read. That ends in a result or in an
error of ours, of one line of at most 4,000 characters. No reader may end otherwise, take over 10
seconds of the processor or wait for a minute, have over 1 GiB more memory at once than before or
ten times what the files take on the disk, or open or change a file of a folder beside: of that
Linux tells, whichever process and library it was, so this runs on Linux alone.
"""

import ctypes
import json
import os
import resource
import signal
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import tyro

from benchmarks.bench import RESULTS, memory_of, put_row, short_commit
from benchmarks.robust.commands import Hang
from benchmarks.robust.examples import DOORS, Door
from benchmarks.robust.fuzz import folder_in_memory, on_alarm
from benchmarks.robust.spoilt import LARGE, restore, spoil
from gsynopsis.errors import GsynopsisError

HANG_SECONDS, WAIT_SECONDS, LINE = 10, 60, 4000
MEMORY, TIMES = 1 << 30, 10
"""Bytes that a small input may take, and those that each byte of a large one may."""
TROUBLES = 20
TABLE = RESULTS / "doors.csv"
ACCEPTED, REFUSED, HANGS, TOO_MUCH = "accepted", "refused", "a hang", "too much memory"
ANY_USE = 0xFFF
"""inotify's events: opened, read, changed, made, moved, removed."""


@dataclass(frozen=True)
class Options:
    """Options of the trial.

    Attributes:
        only: Names of doors; all if empty.
        count: Spoilt inputs for each.
        seconds: For each door, at most; 0 for no limit.
        seed: Seed of the inputs.
        json: Print JSON.
        csv: Put the rows into docs/results/doors.csv; those of other doors stay.
    """

    only: tuple[str, ...] = ()
    count: int = 20_000
    seconds: float = 0.0
    seed: int = 0
    json: bool = False
    csv: bool = False


@dataclass
class Passed:
    """Counts of one door; `trouble` has the first failures."""

    tried: int = 0
    accepted: int = 0
    refused: int = 0
    tracebacks: int = 0
    hangs: int = 0
    memory: int = 0
    outside: int = 0
    slowest_s: float = 0.0
    most_mib: float = 0.0
    trouble: list[str] = field(default_factory=list[str])

    @property
    def failed(self) -> int:
        """All that may not happen."""
        return self.tracebacks + self.hangs + self.memory + self.outside

    def count(self, said: str, what: str) -> None:
        """Count how an input ended, and remember what may not be."""
        self.accepted += said == ACCEPTED
        self.refused += said == REFUSED
        self.hangs += said == HANGS
        self.memory += said == TOO_MUCH
        if said not in (ACCEPTED, REFUSED):
            self.tracebacks += said not in (HANGS, TOO_MUCH)
            self.note(f"{what}: {said}")

    def note(self, what: str) -> None:
        """Remember what happened."""
        if len(self.trouble) < TROUBLES:
            self.trouble.append(what)


class Watch:
    """Notices when any process opens, reads or changes something of a folder."""

    def __init__(self, folder: Path) -> None:
        system = ctypes.CDLL(None, use_errno=True)
        self._events = system.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        if system.inotify_add_watch(self._events, os.fsencode(folder), ANY_USE) < 0:
            raise OSError(ctypes.get_errno(), "inotify")

    def seen(self) -> bool:
        """True if there was something since it was asked before."""
        try:
            return bool(os.read(self._events, 1 << 16))
        except BlockingIOError:
            return False


def attempt(use: Callable[[Path], object], folder: Path) -> str:
    """Read a folder: accepted, refused, a hang, or what went wrong."""
    # Of the processor, so that a machine's other work is no hang; a wait that uses none is.
    signal.setitimer(signal.ITIMER_PROF, HANG_SECONDS)
    signal.alarm(WAIT_SECONDS)
    try:
        use(folder)
    except GsynopsisError as error:
        line = str(error)
        return REFUSED if len(line) < LINE else f"a line of {len(line)} characters"
    except OSError as error:  # one line on the command line, if it says of which file
        return REFUSED if error.strerror else f"{type(error).__name__}: {error}"
    except Hang:
        return HANGS
    except MemoryError:
        return TOO_MUCH
    except Exception as error:
        return f"{type(error).__name__}: {str(error)[:200]}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.alarm(0)
    return ACCEPTED


def children_peak() -> int:
    """The most memory of a process that this one started, bytes."""
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024


def judged(use: Callable[[Path], object], folder: Path, passed: Passed) -> str:
    """As `attempt`, its time and memory judged as well."""
    files = sum(path.lstat().st_blocks * 512 for path in folder.rglob("*"))
    Path("/proc/self/clear_refs").write_text("5")  # the peak of memory begins anew
    before, children, began = memory_of()["VmRSS"], children_peak(), sum(os.times()[:4])
    said = attempt(use, folder)
    took, taken = sum(os.times()[:4]) - began, memory_of()["VmHWM"] - before
    if (child := children_peak()) > children:
        taken = max(taken, child - before)
    passed.slowest_s = max(passed.slowest_s, round(took, 2))
    passed.most_mib = max(passed.most_mib, round(taken / 2**20, 1))
    if took > HANG_SECONDS:
        return HANGS
    return TOO_MUCH if taken > max(MEMORY, TIMES * files) else said


def try_door(door: Door, options: Options, root: Path, watch: Watch) -> Passed:
    """All spoilt inputs of a door."""
    whole, folder, secret = root / door.name, root / "tried", root / "secret"
    whole.mkdir()
    names = door.make(whole)
    rng, passed = np.random.default_rng(options.seed), Passed()
    restore(whole, folder)
    if (said := attempt(door.use, folder)) != ACCEPTED:
        passed.tracebacks += 1
        passed.note(f"the example itself: {said}")
    watch.seen()
    began = time.monotonic()
    while passed.tried < options.count:
        if options.seconds and time.monotonic() - began > options.seconds:
            break
        restore(whole, folder)
        done = spoil(rng, folder, names, secret / "file")
        passed.tried += 1
        what = f"{passed.tried}, {done}"
        passed.count(judged(door.use, folder, passed), what)
        if watch.seen() and not (door.links and done.startswith("a link")):
            passed.outside += 1
            passed.note(f"{what}: a file outside was opened or changed")
    return passed


def cap_memory() -> None:
    """Fail above four times what is allowed, room for a mapped file included, not the machine."""
    limit = memory_of()["VmSize"] + 4 * MEMORY + LARGE
    resource.setrlimit(resource.RLIMIT_AS, (limit, resource.getrlimit(resource.RLIMIT_AS)[1]))


def main() -> int:
    options, results = tyro.cli(Options, description=__doc__), dict[str, Passed]()
    for kind in (signal.SIGPROF, signal.SIGALRM):
        signal.signal(kind, on_alarm)
    cap_memory()
    warnings.simplefilter("ignore")  # as the command does
    with folder_in_memory() as name:
        root = Path(name).resolve()
        (root / "secret").mkdir()
        (root / "secret" / "file").write_text("secret")
        watch = Watch(root / "secret")
        for door in DOORS:
            if options.only and door.name not in options.only:
                continue
            results[door.name] = try_door(door, options, root, watch)
            if options.csv:
                row = asdict(results[door.name]) | {"seed": options.seed, "commit": short_commit()}
                del row["trouble"]
                put_row(TABLE, {"door": door.name, **row}, ("door", "commit"))
            if not options.json:
                print(door.name, vars(results[door.name]), flush=True)
    if options.json:
        print(json.dumps({name: asdict(passed) for name, passed in results.items()}))
    return int(any(passed.failed for passed in results.values()))


if __name__ == "__main__":
    sys.exit(main())
