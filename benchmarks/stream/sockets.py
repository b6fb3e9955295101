"""The parts of streaming that need real sockets, real breaks and real pictures.

    python -m benchmarks.stream.sockets fox=runs/fox bonsai=runs/bonsai

Measures the real and the virtual timeline on two lines (docs/results/sockets.csv), 200 broken
streams, 1,000 clients at once, and popping with and without the fade (docs/results/popping.csv).
"""

import asyncio
import hashlib
import multiprocessing
import resource
import subprocess
import sys
import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import numpy as np
import tyro

from benchmarks.bench import (
    RESULTS,
    RUNS,
    TRACES,
    Row,
    machine,
    put,
    short_commit,
    write_rows,
)
from benchmarks.stream.plays import Conditions, Scene
from gsynopsis.container import decode
from gsynopsis.evaluation.report import Switch
from gsynopsis.jobs.evaluate import smooth_flight
from gsynopsis.jobs.simulate_stream import flight_around
from gsynopsis.playback.popping import measure_switches
from gsynopsis.records import LevelSet
from gsynopsis.render.choose import make_renderer
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.run import serving
from gsynopsis.stream.fetch import Fetcher
from gsynopsis.stream.http import HttpSource
from gsynopsis.stream.lookahead import ours
from gsynopsis.stream.session import Session, SessionOptions
from gsynopsis.stream.trace import read_trace
from gsynopsis.stream.transport import ThreadTransport, Transport
from gsynopsis.stream.virtual import Link, VirtualTransport, random_cuts

EVENTS, SWITCHES = RESULTS / "sockets.csv", RESULTS / "popping.csv"
WITHIN = 0.1
"""Share of the virtual time that an event may come earlier or later."""
SOCKET_TRACES = ("3g_fast", "puffer_typical")
BREAKS = 200
CLIENTS = 1000
CLIENT_READS = 5
ROUNDS = 8
PARTS = ("sockets", "breaks", "clients", "popping")


@dataclass(frozen=True)
class Settings:
    """Options of the measurement.

    Attributes:
        scenes: Scenes as NAME=RUN, where RUN is the folder of an evaluated run.
        traces: Folder of recorded lines.
        page: Page with the marks of this script.
        how: As in lines.py.
        work: Folder for the files that are served.
        parts: What to do; page and CSVs are written only with all of them.
    """

    scenes: tyro.conf.Positional[tuple[str, ...]]
    traces: Path = TRACES
    page: Path = RESULTS / "streaming.md"
    how: Conditions = field(default_factory=Conditions)
    work: Path = RUNS / "sockets"
    parts: tuple[str, ...] = PARTS


def streamed(lines: Transport, levels: LevelSet) -> tuple[Session, Fetcher]:
    fetcher = Fetcher(lines, "scene", seed=0)
    flight = flight_around(dict(levels.meta), levels.frame, 40.0, 240)
    session = Session(fetcher, "scene", SessionOptions(ours, flight.eyes))
    while not session.complete:
        session.advance(float("inf"))
    fetcher.close()
    return session, fetcher


def moments(session: Session) -> dict[str, float]:
    """Times of the header, of every level and of the end, seconds."""
    names = {"header", "base-ready", "level-ready", "complete"}
    return {
        f"{e.name} {e.level}" if e.name == "level-ready" else e.name: e.time
        for e in session.events
        if e.name in names
    }


@contextmanager
def slow_server(path: Path, trace: Path) -> Generator[str]:
    """`gsynopsis serve --trace` in a process of its own; gives the file's address."""
    command = [sys.executable, "-m", "gsynopsis", "serve", str(path), "--port", "0"]
    with subprocess.Popen(
        [*command, "--trace", str(trace)], stdout=subprocess.PIPE, text=True
    ) as server:
        assert server.stdout is not None
        server.stdout.readline()
        address = server.stdout.readline().strip()
        server.stdout.readline()
        time.sleep(0.5)
        try:
            yield address
        finally:
            server.kill()


def real_and_virtual(name: str, path: Path, levels: LevelSet, settings: Settings) -> Generator[Row]:
    """A row for each event: seconds on both clocks."""
    for trace in SOCKET_TRACES:
        link = Link(read_trace(settings.traces / f"{trace}.csv"))
        virtual = moments(streamed(VirtualTransport(path.read_bytes(), link), levels)[0])
        with slow_server(path, settings.traces / f"{trace}.csv") as address:
            real = moments(streamed(ThreadTransport(HttpSource(address)), levels)[0])
        for key, seconds in virtual.items():
            both = {"virtual_s": round(seconds, 3), "sockets_s": round(real[key], 3)}
            apart = round(100 * (real[key] / seconds - 1), 1)
            yield {"scene": name, "line": trace, "event": key, **both, "apart_percent": apart}


def events_text(rows: Sequence[Row]) -> str:
    """Count of the events that come when the virtual clock says, and those that do not."""
    late = [row for row in rows if abs(row["apart_percent"]) > 100 * WITHIN]
    those = "; ".join(
        f"{row['scene']}, {row['line']}, {row['event']}: {row['virtual_s']:.3f} s, "
        f"{row['sockets_s']:.3f} s ({row['apart_percent']:+.1f} %)"
        for row in late
    )
    return (
        f"{len(rows) - len(late)} of {len(rows)} events come within {WITHIN:.0%} of the virtual "
        f"clock{f', all but {those}' if late else ''}.\n"
    )


def switch_row(scene: str, switch: Switch) -> Row:
    """Change of colour at a switch to a finer level, of 255."""
    return {
        "scene": scene,
        "level": switch.level,
        "largest_hard": round(switch.hard_largest, 1),
        "largest_faded": round(switch.faded_largest, 1),
        "mean_hard": round(switch.hard_mean, 3),
        "mean_faded": round(switch.faded_mean, 3),
    }


def switches_text(rows: Sequence[Row]) -> str:
    """Rest of the largest change at a switch of levels that a fade leaves."""
    shares = [row["largest_faded"] / row["largest_hard"] for row in rows]
    return (
        f"A cross-fade leaves {min(shares):.0%} to {max(shares):.0%} of the largest change of "
        "colour from one frame to the next.\n"
    )


def fingerprint(levels: LevelSet) -> str:
    found = hashlib.sha256()
    for array in (levels.shared.lattice, levels.shared.log_scales, levels.shared.offsets):
        found.update(np.ascontiguousarray(array).tobytes())
    for level in levels.levels:
        for array in (level.mask, level.codebook, *level.networks.values()):
            found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


def broken_streams(name: str, data: bytes, levels: LevelSet, settings: Settings) -> str:
    """One stream for each break, at a random byte, then one stream with all of them."""
    goal = fingerprint(decode(data, name))
    trace = read_trace(settings.traces / "4g_slow.csv")
    cuts = random_cuts(len(data), BREAKS, seed=0)
    same, twice = 0, 0
    for where in [*((cut,) for cut in cuts), cuts]:
        session, fetcher = streamed(VirtualTransport(data, Link(trace, cuts=where)), levels)
        same += fingerprint(session.level_set()) == goal
        twice = max(twice, fetcher.received - len(data))
    return (
        f"{name}: {BREAKS} streams with one break each and one with all {BREAKS}: "
        f"{same} of {BREAKS + 1} final models identical by SHA-256, "
        f"at most {twice} bytes twice ({twice / len(data):.3%}).\n"
    )


def many_clients(path: Path) -> str:
    """A thousand clients in another process, each with its own connection, round after round."""
    rounds: list[tuple[int, int]] = []
    memory: list[int] = []
    with serving(make_app(root_of(path))) as address:
        url = f"{address}/{path.name}"
        httpx.get(url)
        before = resident()
        context = multiprocessing.get_context("spawn")
        with context.Pool(1) as pool:
            began = time.perf_counter()
            for _ in range(ROUNDS):
                rounds.append(pool.apply(run_clients, (url, path.stat().st_size)))
                memory.append(resident())
            took = time.perf_counter() - began
    good, wrong = (sum(column) for column in zip(*rounds, strict=True))
    return (
        f"{CLIENTS:,} clients at once, {ROUNDS} rounds of {CLIENT_READS} ranges of 16 KiB each: "
        f"{good:,} right, {wrong} wrong or failed, {good / took:.0f} ranges/s; the server's memory "
        f"was {before} MiB before, and after each round {', '.join(map(str, memory))} MiB.\n"
    )


def resident() -> int:
    """Resident memory of this process, MiB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() >> 20


def run_clients(url: str, size: int) -> tuple[int, int]:
    """Numbers of right and of wrong reads, of all clients."""

    async def client(number: int, gate: asyncio.Event) -> tuple[int, int]:
        good = wrong = 0
        async with httpx.AsyncClient(timeout=60.0, trust_env=False, verify=False) as session:
            await gate.wait()
            for turn in range(CLIENT_READS):
                start = (number * 7919 + turn * 104729) % (size - 16384)
                wanted = {"Range": f"bytes={start}-{start + 16383}"}
                try:
                    answer = await session.get(url, headers=wanted)
                except httpx.HTTPError:
                    wrong += 1
                    continue
                shown = f"bytes {start}-{start + 16383}/{size}"
                right = answer.status_code == 206 and len(answer.content) == 16384
                right = right and answer.headers["content-range"] == shown
                good, wrong = good + right, wrong + (not right)
        return good, wrong

    async def all_clients() -> tuple[int, int]:
        gate = asyncio.Event()
        tasks = [asyncio.create_task(client(n, gate)) for n in range(CLIENTS)]
        await asyncio.sleep(0.5)
        gate.set()
        found = await asyncio.gather(*tasks)
        return sum(g for g, _ in found), sum(w for _, w in found)

    return asyncio.run(all_clients())


def told(settings: Settings, events: list[Row], switches: list[Row]) -> Generator[str]:
    """The page's part, line by line; rows of both CSVs are put into the lists."""
    scenes: dict[str, tuple[Path, LevelSet]] = {}
    settings.work.mkdir(parents=True, exist_ok=True)
    renderer = make_renderer("auto")
    for word in settings.scenes:
        name, _, path = word.partition("=")
        scene = Scene(name, Path(path), settings.how, renderer)
        target = settings.work / f"{name}.gsyn"
        target.write_bytes(scene.data)
        scenes[name] = target, scene.levels
    if "sockets" in settings.parts:
        for name, (path, levels) in scenes.items():
            events += real_and_virtual(name, path, levels, settings)
        yield events_text(events)
    if "breaks" in settings.parts:
        for name, (path, levels) in scenes.items():
            yield broken_streams(name, path.read_bytes(), levels, settings)
    if "clients" in settings.parts:
        yield many_clients(next(iter(scenes.values()))[0])
    if "popping" in settings.parts:
        for name, (_, levels) in scenes.items():
            found = measure_switches(levels, smooth_flight(levels), renderer)
            switches += [switch_row(name, switch) for switch in found]
        yield switches_text(switches)


def main(settings: Settings) -> None:
    """Measure, print, and write page and CSVs."""
    events, switches = list[Row](), list[Row]()
    facts = machine(make_renderer("auto").device)
    lines = [f"{facts.cpu}, {facts.cores} cores, commit {short_commit()}.\n"]
    print(lines[0])
    for line in told(settings, events, switches):
        print(line, flush=True)
        lines.append(line)
    if settings.parts == PARTS:
        write_rows(EVENTS, events)
        write_rows(SWITCHES, switches)
        put(settings.page, __file__, "\n".join(lines))
        print(f"wrote {settings.page}")


if __name__ == "__main__":
    main(tyro.cli(Settings, description=__doc__))
