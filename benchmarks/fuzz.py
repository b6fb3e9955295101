"""Seeded mutations of .gsyn files: each must be refused, quickly and in little memory.

    python benchmarks/fuzz.py                      # 10,000 mutations of the three test vectors
    python benchmarks/fuzz.py --seconds 30         # as many as fit

Half of the mutations leave checksums wrong: none may be accepted. The other half have every
checksum of header and chunks made right, as an attacker would: they may be accepted only if they
decode to finite values within the format's limits; no other exception may escape.
"""

import json
import resource
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import numpy as np
import tyro

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))

from tests.pack.forge import flat, index_of, mended  # noqa: E402

from gsynopsis.errors import FormatError  # noqa: E402
from gsynopsis.pack import decode  # noqa: E402
from gsynopsis.records import LevelSet  # noqa: E402

VECTORS = ROOT / "tests" / "pack" / "vectors"
FILES = ("small-compact", "both-raw", "free-compact")
HANG_SECONDS = 5
MEMORY_CAP = 256 << 20
"""Address space above what the process already uses; beyond it an allocation fails."""


@dataclass(frozen=True)
class Options:
    """What to run.

    Attributes:
        count: Mutations in all.
        seed: Of the mutations.
        seconds: Stop after this long; 0 for no limit.
        json: Print JSON.
    """

    count: int = 10_000
    seed: int = 0
    seconds: float = 0.0
    json: bool = False


@dataclass
class Tally:
    """What happened."""

    executions: int = 0
    refused: int = 0
    accepted_forged: int = 0
    silent_accepts: int = 0
    crashes: int = 0
    hangs: int = 0
    slowest_ms: float = 0.0
    seconds: float = 0.0


class Hang(Exception):
    """One file took longer than it may."""


def mutate(rng: np.random.Generator, data: bytes) -> bytes:
    """Bits, runs, cuts, repeats and swaps; at least one byte is different."""
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        at, kind = int(rng.integers(len(changed))), int(rng.integers(6))
        run = int(rng.integers(1, 17))
        if kind == 0:
            changed[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            changed[at : at + run] = rng.bytes(len(changed[at : at + run]))
        elif kind == 2:
            changed[at : at + run] = bytes([(0, 255)[int(rng.integers(2))]]) * len(
                changed[at : at + run]
            )
        elif kind == 3 and len(changed) > 200:
            del changed[at : at + run]
        elif kind == 4:
            changed[at:at] = changed[at : at + run]
        else:
            other = int(rng.integers(len(changed)))
            changed[at], changed[other] = changed[other], changed[at]
    return bytes(changed)


def forge(rng: np.random.Generator, data: bytes) -> bytes:
    """Tables or body changed without moving anything, and every checksum made right."""
    length = index_of(data).length
    start, stop = (20, length) if rng.integers(2) else (length, len(data))
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(start, stop))
        changed[at] = int(rng.integers(256))
    return mended(bytes(changed))


def sound(levels: LevelSet) -> bool:
    """Whether all that was decoded is finite."""
    s = levels.shared
    arrays = [s.log_scales, s.offsets, s.residual, *s.grids]
    return all(bool(np.isfinite(array).all()) for array in arrays)


def attempt(data: bytes, forged: bool, tally: Tally) -> None:
    """Decode one mutation and count what happened."""
    started = time.perf_counter()
    signal.alarm(HANG_SECONDS)
    try:
        levels = decode(data, "mutation")
    except FormatError:
        tally.refused += 1
    except Hang:
        tally.hangs += 1
    except Exception as error:
        tally.crashes += 1
        print(f"execution {tally.executions}: {type(error).__name__}: {error}", file=sys.stderr)
    else:
        if forged and sound(levels):
            tally.accepted_forged += 1
        else:
            tally.silent_accepts += 1
    finally:
        signal.alarm(0)
    tally.executions += 1
    tally.slowest_ms = max(tally.slowest_ms, 1e3 * (time.perf_counter() - started))


def run(options: Options) -> Tally:
    """All mutations."""
    rng, tally = np.random.default_rng(options.seed), Tally()
    files = [(VECTORS / f"{name}.gsyn").read_bytes() for name in FILES]
    plain = [flat(data) for data in files]
    started = time.perf_counter()
    while tally.executions < options.count:
        which, forged = tally.executions % len(files), bool(rng.integers(2))
        data = forge(rng, plain[which]) if forged else mutate(rng, files[which])
        if data not in (files[which], plain[which]):
            attempt(data, forged, tally)
        tally.seconds = time.perf_counter() - started
        if options.seconds and tally.seconds > options.seconds:
            break
    return tally


def on_alarm(number: int, frame: FrameType | None) -> None:
    raise Hang


def cap_memory() -> None:
    """No more than `MEMORY_CAP` beyond what is mapped now."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY_CAP
    resource.setrlimit(resource.RLIMIT_AS, (limit, resource.getrlimit(resource.RLIMIT_AS)[1]))


def main() -> int:
    options = tyro.cli(Options, description=__doc__)
    signal.signal(signal.SIGALRM, on_alarm)
    if sys.platform == "linux":
        cap_memory()
    tally = run(options)
    print(json.dumps(vars(tally)) if options.json else f"{vars(tally)}")
    return int(bool(tally.crashes or tally.hangs or tally.silent_accepts))


if __name__ == "__main__":
    sys.exit(main())
