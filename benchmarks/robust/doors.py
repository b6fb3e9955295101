"""Spoilt inputs through every reader of other people's files: a result or one line, in bounds.

    python -m benchmarks.robust.doors                              # 20,000 for each door
    python -m benchmarks.robust.doors --only run checkpoint --count 500
    python -m benchmarks.robust.doors --seconds 2                  # seconds at most for each door

One file of a small valid example is spoilt (`spoilt.py`) and read. That ends in a result or in an
error of ours, of one line of at most 4,000 characters. No reader may end otherwise, take over 10
seconds, take over 1 GiB more than before or ten times the files, open a file of a folder beside or
change it.
"""

import hashlib
import json
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from benchmarks.robust.examples import DOORS, Door
from benchmarks.robust.fuzz import Hang, on_alarm, peak_mib
from benchmarks.robust.spoilt import restore, spoil
from gsynopsis.errors import GsynopsisError

HANG_SECONDS, MEMORY_MIB, LINE = 10, 1024, 4000
TROUBLES = 20


@dataclass(frozen=True)
class Options:
    """Options of the trial.

    Attributes:
        only: Names of doors; all if empty.
        count: Spoilt inputs for each.
        seconds: For each door, at most; 0 for no limit.
        seed: Seed of the inputs.
        sparse: Include files of 3 GiB of zeros.
        json: Print JSON.
    """

    only: tuple[str, ...] = ()
    count: int = 20_000
    seconds: float = 0.0
    seed: int = 0
    sparse: bool = True
    json: bool = False


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
    growth_mib: float = 0.0
    trouble: list[str] = field(default_factory=list[str])

    @property
    def failed(self) -> int:
        """All that may not happen."""
        return self.tracebacks + self.hangs + self.memory + self.outside

    def note(self, what: str) -> None:
        """Remember what happened."""
        if len(self.trouble) < TROUBLES:
            self.trouble.append(what)


class Watch:
    """Audit hook that notices when Python opens a file of the secret folder."""

    def __init__(self, secret: Path) -> None:
        self.secret, self.opened = str(secret), False
        sys.addaudithook(self._hook)

    def _hook(self, event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open" and isinstance(arguments[0], str) and "secret" in arguments[0]:
            self.opened = self.opened or arguments[0].startswith(self.secret)


def digest(folder: Path) -> str:
    """Digest of all names and bytes below a folder."""
    found = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        found.update(f"{path.relative_to(folder)}\n".encode())
        found.update(path.read_bytes() if path.is_file() else b"")
    return found.hexdigest()


def attempt(use: Callable[[Path], object], folder: Path) -> str:
    """Read a folder: "accepted", "refused", or what went wrong."""
    signal.setitimer(signal.ITIMER_REAL, HANG_SECONDS)
    try:
        use(folder)
    except GsynopsisError as error:
        signal.setitimer(signal.ITIMER_REAL, 0)
        line = str(error)
        return "refused" if len(line) < LINE else f"a line of {len(line)} characters"
    except OSError as error:  # one line on the command line, if it says of which file
        signal.setitimer(signal.ITIMER_REAL, 0)
        return "refused" if error.strerror else f"{type(error).__name__}: {error}"
    except Hang:
        return "hang"
    except MemoryError:
        signal.setitimer(signal.ITIMER_REAL, 0)
        return "memory"
    except Exception as error:
        signal.setitimer(signal.ITIMER_REAL, 0)
        return f"{type(error).__name__}: {str(error)[:200]}"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    return "accepted"


def try_door(door: Door, options: Options, root: Path, watch: Watch) -> Passed:
    """All spoilt inputs of a door."""
    whole, folder, secret = root / door.name, root / "tried", root / "secret"
    whole.mkdir()
    names = door.make(whole)
    rng, passed, began = np.random.default_rng(options.seed), Passed(), time.time()
    restore(whole, folder)
    if (said := attempt(door.use, folder)) != "accepted":
        passed.note(f"the example itself: {said}")
        passed.tracebacks += 1
    before, kept = peak_mib(), digest(secret)
    while passed.tried < options.count:
        if options.seconds and time.time() - began > options.seconds:
            break
        restore(whole, folder)
        done = spoil(rng, folder, names, secret / "file", sparse=options.sparse)
        watch.opened, started = False, time.perf_counter()
        said = attempt(door.use, folder)
        passed.tried += 1
        passed.slowest_s = max(passed.slowest_s, time.perf_counter() - started)
        passed.growth_mib = max(passed.growth_mib, peak_mib() - before)
        passed.accepted += said == "accepted"
        passed.refused += said == "refused"
        if said not in ("accepted", "refused"):
            passed.hangs += said == "hang"
            passed.memory += said == "memory"
            passed.tracebacks += said not in ("hang", "memory")
            passed.note(f"{passed.tried}, {done}: {said}")
        if (watch.opened and "a link" not in done) or digest(secret) != kept:
            passed.outside += 1
            passed.note(f"{passed.tried}, {done}: a file outside was opened or changed")
    return passed


def cap() -> None:
    """Limit memory to 1 GiB beyond what is mapped now, with room for a sparse file to be mapped."""
    if sys.platform == "linux":
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limit = pages * resource.getpagesize() + (MEMORY_MIB << 20) + (3 << 30)
        resource.setrlimit(resource.RLIMIT_AS, (limit, resource.getrlimit(resource.RLIMIT_AS)[1]))


def main() -> int:
    options = tyro.cli(Options, description=__doc__)
    signal.signal(signal.SIGALRM, on_alarm)
    results: dict[str, Passed] = {}
    with tempfile.TemporaryDirectory() as name:
        root = Path(name).resolve()
        (root / "secret").mkdir()
        (root / "secret" / "file").write_text("secret")
        watch = Watch(root / "secret")
        for door in DOORS:
            if options.only and door.name not in options.only:
                continue
            results[door.name] = try_door(door, options, root, watch)
            if not options.json:
                print(door.name, vars(results[door.name]), flush=True)
    if options.json:
        print(json.dumps({name: asdict(passed) for name, passed in results.items()}))
    return int(any(passed.failed for passed in results.values()))


if __name__ == "__main__":
    sys.exit(main())
