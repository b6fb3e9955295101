"""The rate that ordinary clients of nginx keep beside hostile ones, with our configuration.

    python -m benchmarks.robust.server --page docs/results/robustness.md \
        --csv docs/results/server.csv

Debian's nginx with `packaging/nginx.conf`, on this machine's loopback; ordinary clients that ask as
fast as they can in one process, and hostile ones in another. Hostile clients come from as many
addresses, so that a limit by address helps nobody, and then all from the address of the ordinary
ones, so that this limit meets these too. What is kept is measured by the clock, and, since that
also counts whatever else the machine does, the hostile clients' own work too, in ranges for each
second of the server's processor time. Ends with 1 if less than 80 % of that is kept, more than 1 %
of requests fail, a client waits for long, or the log of errors grows by more than 1 MB.
"""

import asyncio
import multiprocessing
import os
import resource
import sys
import tempfile
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from multiprocessing.synchronize import Event
from pathlib import Path

import tyro

from benchmarks.bench import machine, put, short_commit, write_rows
from benchmarks.robust.nginx import NGINX, Nginx, nginx

NAME = "scene.gsyn"
FILE_MIB = 64
LEAST_SHARE = 0.8
LOG_MAX = 1_000_000
WAIT_MAX = 5.0
WHOLE = b"GET /scene.gsyn HTTP/1.1\r\nHost: a\r\n\r\n"
SHORT = b"GET /scene.gsyn HTTP/1.1\r\nHost: a\r\nRange: bytes=0-99\r\n\r\n"
HEAD = b"GET /scene.gsyn HTTP/1.1\r\nHost: a\r\nX-Long: "
BODY = b"POST /scene.gsyn HTTP/1.1\r\nHost: a\r\nContent-Length: 1000000000\r\n\r\n"
KINDS: dict[str, tuple[bytes, bool, bool]] = {
    "say nothing": (b"", False, True),
    "rest after an answer": (SHORT, False, True),
    "drip a head": (HEAD, True, True),
    "drip a second head": (SHORT + HEAD, True, True),
    "drip a body of 1 GB": (BODY, True, True),
    "never read 64 MiB": (WHOLE, False, False),
    "talk nonsense": (b"nonsense\r\n\r\n", True, True),
}
"""A hostile client: its first bytes, the pace of those that follow, and if it reads."""
DRIP_SECONDS = 0.5
AGAIN_SECONDS = 1.0
"""A hostile client whose connection was closed comes back so long after it had come."""


@dataclass(frozen=True)
class Settings:
    """Options of the measurement.

    Attributes:
        hostile: Hostile connections at once, at most 1000.
        clients: Ordinary clients at once, each as fast as it can.
        seconds: Beside each kind, at most 60; half as long alone, before and after.
        kinds: Those to try, all if none are named.
        page: Page with the marks of this script; nothing is written without.
        csv: Where the rows go; nothing is written without.
    """

    hostile: int = 500
    clients: int = 8
    seconds: float = 6.0
    kinds: tuple[str, ...] = ()
    page: Path | None = None
    csv: Path | None = None


@dataclass(frozen=True)
class Row:
    """Result of one kind of hostile clients.

    Attributes:
        hostile: The kind.
        addresses: Each of them has an address of its own; else all have that of ordinary clients.
        alone: Ranges of 16 KiB a second without hostile clients.
        beside: The same beside them.
        cpu_alone: Ranges for each second of the server's processor time, alone.
        cpu_beside: The same beside hostile clients.
        failed: Requests of ordinary clients that failed beside them.
        wait: The longest that one waited for its range beside them, seconds.
        log: Bytes that the log of errors grew by.
        mib: The memory of its processes beside them, MiB; what they share counts for each.
    """

    hostile: str
    addresses: bool
    alone: float
    beside: float
    cpu_alone: float
    cpu_beside: float
    failed: int
    wait: float
    log: int
    mib: int

    @property
    def kept(self) -> float:
        """Share of undisturbed ranges per second of server time that ordinary clients keep."""
        return self.cpu_beside / self.cpu_alone

    @property
    def good(self) -> bool:
        """Ordinary clients and the disk come through it."""
        few = self.failed <= 0.01 * self.beside
        return self.kept >= LEAST_SHARE and few and self.wait < WAIT_MAX and self.log <= LOG_MAX


@dataclass
class Tally:
    """Answers that ordinary clients got."""

    good: int = 0
    failed: int = 0
    wait: float = 0.0
    seconds: float = 0.0
    cpu: float = 0.0

    def __add__(self, other: "Tally") -> "Tally":
        return Tally(
            self.good + other.good,
            self.failed + other.failed,
            max(self.wait, other.wait),
            self.seconds + other.seconds,
            self.cpu + other.cpu,
        )


async def ask(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, start: int) -> bool:
    """Read a range; the server keeps the connection."""
    wanted = f"Range: bytes={start}-{start + 16383}\r\n"
    writer.write(WHOLE[:-2] + wanted.encode() + b"\r\n")
    head = await reader.readuntil(b"\r\n\r\n")
    if not head.startswith(b"HTTP/1.1 206"):
        raise ConnectionError(head[:40])
    await reader.readexactly(16384)
    return b"\r\nconnection: close\r\n" not in head.lower()


async def ordinary(port: int, number: int, ended: float) -> Tally:
    """Read ranges until the end of the time."""
    found = Tally()
    asked = time.monotonic()
    while asked < ended:
        try:
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            try:
                kept = True  # nginx ends a connection after 1,000 requests
                while kept and asked < ended:
                    start = (number * 7919 + found.good * 104729) % (FILE_MIB << 20) & ~16383
                    kept = await asyncio.wait_for(ask(reader, writer, start), 10)
                    found.good += 1
                    found.wait = max(found.wait, time.monotonic() - asked)
                    asked = time.monotonic()
            finally:
                writer.close()
        except (OSError, EOFError, TimeoutError):
            found.failed += 1
            await asyncio.sleep(0.05)
            if time.monotonic() > ended:
                break
    return found


def all_ordinary(port: int, clients: int, seconds: float) -> Tally:
    """Answers that all clients got in that time."""

    async def run() -> list[Tally]:
        ended = time.monotonic() + seconds
        return await asyncio.gather(*(ordinary(port, n, ended) for n in range(clients)))

    return sum(asyncio.run(run()), Tally(seconds=seconds))


async def one_hostile(port: int, kind: str, local: tuple[str, int] | None) -> None:
    """Once: connect, do harm until the connection is closed."""
    first, drips, reads = KINDS[kind]
    reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=1024, local_addr=local)
    try:
        writer.write(first)
        if not reads:
            await asyncio.sleep(3600)
        reading = asyncio.ensure_future(reader.read())
        while not reading.done():
            await asyncio.wait([reading], timeout=DRIP_SECONDS if drips else None)
            if drips and not reading.done():
                writer.write(b"x")
        await reading
    finally:
        writer.transport.abort()


def all_hostile(port: int, kind: str, count: int, addresses: bool, begun: Event) -> None:
    """So many hostile clients at once, until the process is ended."""

    async def again(number: int) -> None:
        await asyncio.sleep(number * AGAIN_SECONDS / count)
        local = (f"127.1.{number // 250}.{number % 250 + 1}", 0) if addresses else None
        while True:
            began = time.monotonic()
            with suppress(OSError, EOFError):
                await one_hostile(port, kind, local)
            await asyncio.sleep(max(0.0, began + AGAIN_SECONDS - time.monotonic()))

    async def run() -> None:
        begun.set()
        await asyncio.gather(*(again(number) for number in range(count)))

    asyncio.run(run())


@contextmanager
def hostile(port: int, kind: str, count: int, addresses: bool) -> Generator[None]:
    """Hostile clients in a process of their own while the `with` lasts."""
    context = multiprocessing.get_context("spawn")
    begun = context.Event()
    arguments = (port, kind, count, addresses, begun)
    child = context.Process(target=all_hostile, args=arguments, daemon=True)
    child.start()
    if not begun.wait(120):  # it imports what this module does
        raise RuntimeError("hostile clients do not start")
    time.sleep(2 * AGAIN_SECONDS)
    try:
        yield
    finally:
        child.kill()
        child.join()


def processes(server: Nginx) -> list[int]:
    """Its master and its workers."""
    children = Path(f"/proc/{server.process}/task/{server.process}/children").read_text()
    return [server.process, *map(int, children.split())]


def cpu_of(server: Nginx) -> float:
    """Processor time of all its processes, seconds."""
    ticks = 0
    for process in processes(server):
        words = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        ticks += int(words[11]) + int(words[12])
    return ticks / os.sysconf("SC_CLK_TCK")


def mib_of(server: Nginx) -> int:
    """Memory of all its processes, MiB."""
    pages = (int(Path(f"/proc/{p}/statm").read_text().split()[1]) for p in processes(server))
    return sum(pages) * resource.getpagesize() >> 20


def measured(settings: Settings, folder: Path) -> Generator[Row]:
    """A row for each kind, from addresses of their own and from that of the ordinary clients."""
    (folder / NAME).write_bytes(os.urandom(1 << 20) * FILE_MIB)
    for addresses in (True, False):
        with nginx(folder) as server, multiprocessing.get_context("spawn").Pool(1) as pool:

            def got(seconds: float) -> Tally:
                before = cpu_of(server)
                tally = pool.apply(all_ordinary, (server.port, settings.clients, seconds))
                return tally + Tally(cpu=cpu_of(server) - before)

            alone = got(settings.seconds / 2)
            for kind in settings.kinds or KINDS:
                log = server.log.stat().st_size
                with hostile(server.port, kind, settings.hostile, addresses):
                    beside = got(settings.seconds)
                    mib = mib_of(server)
                after = got(settings.seconds / 2)
                alone += after
                yield Row(
                    hostile=kind,
                    addresses=addresses,
                    alone=round(alone.good / alone.seconds, 1),
                    beside=round(beside.good / beside.seconds, 1),
                    cpu_alone=round(alone.good / alone.cpu, 1),
                    cpu_beside=round(beside.good / beside.cpu, 1),
                    failed=beside.failed,
                    wait=round(beside.wait, 2),
                    log=server.log.stat().st_size - log,
                    mib=mib,
                )
                alone = after


COLUMNS = (
    "hostile clients",
    "from",
    "alone, ranges/s",
    "beside",
    "alone, ranges per s of the server's CPU",
    "beside",
    "kept by the clock",
    "kept by CPU",
    "failed",
    "longest wait, s",
    "log of errors, bytes",
    "MiB",
)


def cells(row: Row) -> str:
    words = (
        row.hostile,
        "as many addresses" if row.addresses else "the same address",
        f"{row.alone:.0f}",
        f"{row.beside:.0f}",
        f"{row.cpu_alone:.0f}",
        f"{row.cpu_beside:.0f}",
        f"{row.beside / row.alone:.0%}",
        f"{row.kept:.0%}",
        row.failed,
        row.wait,
        f"{row.log:,}",
        row.mib,
    )
    return f"| {' | '.join(map(str, words))} |"


def main(settings: Settings) -> int:
    """Measure, print, and write page and rows."""
    if not 0 < settings.hostile <= 1000 or not 0 < settings.seconds <= 60:
        raise SystemExit("--hostile 1 to 1000, --seconds up to 60")
    if NGINX is None:
        raise SystemExit("no nginx: apt-get install nginx-light")
    facts = machine()
    lines = [
        f"{settings.hostile} hostile connections at once, {settings.clients} ordinary clients, "
        f"{settings.seconds:g} s each; {facts.cpu}, {facts.cores} cores, "
        f"commit {short_commit()}.\n",
        f"| {' | '.join(COLUMNS)} |",
        "|---" * len(COLUMNS) + "|",
    ]
    print("\n".join(lines))
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as name:
        for row in measured(settings, Path(name)):
            rows.append(row)
            lines.append(cells(row))
            print(lines[-1], flush=True)
    if settings.page:
        put(settings.page, __file__, "\n".join(lines))
    if settings.csv:
        write_rows(settings.csv, [asdict(row) for row in rows])
    bad = [f"{row.hostile}{'' if row.addresses else ' (same)'}" for row in rows if not row.good]
    print(f"not good: {', '.join(bad)}" if bad else "good")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings, description=__doc__)))
