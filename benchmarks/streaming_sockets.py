"""The parts of streaming that need real sockets, real breaks and real pictures.

    python benchmarks/streaming_sockets.py fox=runs/fox/scene.gsyn --traces ../shared/data/traces

Prints the real and the virtual timeline on two traces, 200 broken streams, 1,000 clients at once,
and popping with and without the fade.
"""

import asyncio
import hashlib
import itertools
import multiprocessing
import resource
import subprocess
import sys
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import httpx
import numpy as np
import tyro

from gsynopsis.cli.stream import flight_around
from gsynopsis.evaluate.machine import this_build, this_machine
from gsynopsis.evaluate.popping import measure_popping
from gsynopsis.model.mixed import FADE_FRAMES, MixedModel
from gsynopsis.pack import decode, read_gsyn
from gsynopsis.pack.writer import encode_with_account
from gsynopsis.records import LevelSet
from gsynopsis.render.choose import make_renderer
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.run import serving
from gsynopsis.stream.fetch import Fetcher
from gsynopsis.stream.http import HttpSource
from gsynopsis.stream.lines import Lines, ThreadLines
from gsynopsis.stream.session import Plan, Session
from gsynopsis.stream.trace import read_trace
from gsynopsis.stream.viewed import ours
from gsynopsis.stream.virtual import Link, VirtualLines, random_cuts

SOCKET_TRACES = ("3g_fast", "puffer_typical")
BREAKS = 200
CLIENTS = 1000
CLIENT_READS = 5


@dataclass(frozen=True)
class Settings:
    """What to measure.

    Attributes:
        scenes: Scenes as NAME=FILE.
        traces: Folder of recorded lines.
        block: Largest number of anchors of a spatial block.
        work: Folder for the files that are served.
        parts: What to measure.
    """

    scenes: tyro.conf.Positional[tuple[str, ...]]
    traces: Path = Path("../shared/data/traces")
    block: int = 1024
    work: Path = Path("runs/sockets")
    parts: tuple[str, ...] = ("sockets", "breaks", "clients", "popping")


def streamed(lines: Lines, levels: LevelSet) -> tuple[Session, Fetcher]:
    fetcher = Fetcher(lines, "scene", seed=0)
    flight = flight_around(dict(levels.meta), levels.frame, 40.0, 240)
    session = Session(fetcher, "scene", Plan(ours, flight.eyes))
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


def real_and_virtual(name: str, path: Path, levels: LevelSet, settings: Settings) -> None:
    for trace in SOCKET_TRACES:
        link = Link(read_trace(settings.traces / f"{trace}.csv"))
        virtual = moments(streamed(VirtualLines(path.read_bytes(), link), levels)[0])
        with slow_server(path, settings.traces / f"{trace}.csv") as address:
            real = moments(streamed(ThreadLines(HttpSource(address)), levels)[0])
        for key, seconds in virtual.items():
            apart = real[key] / seconds - 1
            print(
                f"| {name} | {trace} | {key} | {seconds:.3f} | {real[key]:.3f} | {apart:+.1%} |",
                flush=True,
            )


def fingerprint(levels: LevelSet) -> str:
    found = hashlib.sha256()
    for array in (levels.shared.lattice, levels.shared.log_scales, levels.shared.offsets):
        found.update(np.ascontiguousarray(array).tobytes())
    for level in levels.levels:
        for array in (level.mask, level.codebook, *level.networks.values()):
            found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


def broken_streams(name: str, data: bytes, levels: LevelSet, settings: Settings) -> None:
    """One stream for each break, at a random byte, then one stream with all of them."""
    goal = fingerprint(decode(data, name))
    trace = read_trace(settings.traces / "4g_slow.csv")
    cuts = random_cuts(len(data), BREAKS, seed=0)
    same, twice = 0, 0
    for where in [*((cut,) for cut in cuts), cuts]:
        session, fetcher = streamed(VirtualLines(data, Link(trace, cuts=where)), levels)
        same += fingerprint(session.level_set()) == goal
        twice = max(twice, fetcher.received - len(data))
    print(
        f"{name}: {BREAKS} streams with one break each and one with all {BREAKS}: "
        f"{same} of {BREAKS + 1} final models identical by SHA-256, "
        f"at most {twice} bytes twice ({twice / len(data):.3%})"
    )


def many_clients(path: Path) -> None:
    """A thousand clients in another process, each with its own connection, all at once."""
    with serving(make_app(root_of(path))) as address:
        url = f"{address}/{path.name}"
        httpx.get(url)
        before, peak = resident(), [0]
        stop = threading.Event()

        def watch() -> None:
            while not stop.wait(0.05):
                peak[0] = max(peak[0], resident())

        watcher = threading.Thread(target=watch)
        watcher.start()
        context = multiprocessing.get_context("spawn")
        with context.Pool(1) as pool:
            began = time.perf_counter()
            first = pool.apply(run_clients, (url, path.stat().st_size))
            middle = resident()
            second = pool.apply(run_clients, (url, path.stat().st_size))
            took = time.perf_counter() - began
        stop.set()
        watcher.join()
        after = resident()
    good, wrong = first[0] + second[0], first[1] + second[1]
    print(
        f"{CLIENTS} clients at once, twice {CLIENT_READS} ranges of 16 KiB each: {good} right, "
        f"{wrong} wrong or failed, {good / took:.0f} ranges/s; "
        f"server's memory {before} MiB before, {middle} after the first round, "
        f"{after} after the second, {peak[0]} at most"
    )


def resident() -> int:
    """Resident memory of this process, MiB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() >> 20


def run_clients(url: str, size: int) -> tuple[int, int]:
    """How many reads of all clients were right, and how many not."""

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


def popping(name: str, levels: LevelSet) -> None:
    """A flight of 7.5° per second at 30 frames per second, at each switch of levels."""
    renderer = make_renderer("auto")
    flight = flight_around(dict(levels.meta), levels.frame, 48.0, 320)
    cameras = tuple(flight.at(n / 30) for n in range(FADE_FRAMES + 2))
    states: list[MixedModel] = []
    for level in range(len(levels.levels)):
        part = levels.upto(level)
        region = np.full(part.levels[-1].anchors, level, np.uint8)
        states.append(MixedModel(part, region, renderer.device))
    for level, (old, new) in enumerate(itertools.pairwise(states)):
        hard = measure_popping(old, new, cameras, renderer, 1)
        soft = measure_popping(old, new, cameras, renderer, FADE_FRAMES)
        print(
            f"| {name} | L{level} → L{level + 1} | {hard.largest:.1f} | {soft.largest:.1f} "
            f"({soft.largest / hard.largest:.0%}) | {hard.mean:.3f} | {soft.mean:.3f} "
            f"({soft.mean / hard.mean:.0%}) |"
        )


def main(settings: Settings) -> None:
    machine, build = this_machine(make_renderer("auto").device), this_build()
    print(f"{machine.cpu}, {machine.cores} cores, commit {build.commit}\n")
    scenes: dict[str, tuple[Path, LevelSet]] = {}
    settings.work.mkdir(parents=True, exist_ok=True)
    for word in settings.scenes:
        name, _, path = word.partition("=")
        levels = read_gsyn(Path(path))
        levels = replace(levels, meta=dict(levels.meta))
        target = settings.work / f"{name}.gsyn"
        target.write_bytes(encode_with_account(levels, block=settings.block)[0])
        scenes[name] = target, levels
    if "sockets" in settings.parts:
        print(
            "| scene | trace | event | virtual, s | sockets, s | apart |\n|---|---|---|---|---|---|"
        )
        for name, (path, levels) in scenes.items():
            real_and_virtual(name, path, levels, settings)
        print()
    if "breaks" in settings.parts:
        for name, (path, levels) in scenes.items():
            broken_streams(name, path.read_bytes(), levels, settings)
    if "clients" in settings.parts:
        many_clients(next(iter(scenes.values()))[0])
    if "popping" in settings.parts:
        print("\n| scene | switch | largest, hard | faded | mean, hard | faded |")
        print("|---|---|---|---|---|---|")
        for name, (_, levels) in scenes.items():
            popping(name, levels)


if __name__ == "__main__":
    main(tyro.cli(Settings))
