"""A made-up file of 100 MB through pack, check, cut, serve, stream, viewer: time, memory, bytes.

    python -m benchmarks.stream.large

The scene is a city of anchors with the statistics of trained ones (benchmarks/viewer/city.py), in
blocks of 1,024. Each step is a process of its own; the viewer looks over a recorded line. Needs
node, Chromium and `npm ci` in viewer/ for the last rows.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

from benchmarks.bench import RESULTS, RUNS, TRACES, Row, machine, put, short_commit, write_rows
from benchmarks.viewer import first_picture
from benchmarks.viewer.browser import MISSING, visit
from benchmarks.viewer.city import anchored
from gsynopsis.container.writer import write_gsyn
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.page import FOLDER
from gsynopsis.serve.run import serving
from gsynopsis.stream.fetch import Fetcher
from gsynopsis.stream.http import HttpSource
from gsynopsis.stream.lookahead import ours
from gsynopsis.stream.session import Session, SessionOptions, still
from gsynopsis.stream.transport import ThreadTransport

CSV, NOTE = RESULTS / "large.csv", RESULTS / "scale.md"
FORWARD = (
    "(async () => { const v = viewer(); const { position, target } = v.camera;"
    " const ahead = position.map((p, i) => (target[i] - p) * 0.6);"
    " v.camera = { position: position.map((p, i) => p + ahead[i]), target };"
    " let before = -1; let quiet = 0; while (quiet < 20) {"
    " await new Promise((r) => setTimeout(r, 100)); const now = v.stats.bytes;"
    " quiet = now === before ? quiet + 1 : 0; before = now; } })()"
)
"""Over the first houses; then wait until nothing more comes."""
STATE = (
    "({ bytes: viewer().stats.bytes, drawn: viewer().scene.drawn,"
    " tables: viewer().scene.memory.tables + viewer().scene.memory.decoded })"
)


@dataclass(frozen=True)
class Options:
    """Options of the measurement.

    Attributes:
        anchors: Anchors of the city, some fewer where two fall into one cell.
        block: Largest number of anchors of a block.
        base: The same at level 0.
        budget: Most splats that the viewer renders.
        trace: The line over which the viewer loads.
        out: Folder of the file, which is not made again.
        step: For the processes of single steps.
        address: For those that stream.
    """

    anchors: int = 4_600_000
    block: int = 1024
    base: int = 512
    budget: int = 2_000_000
    trace: Path = TRACES / "3g_slow.csv"
    out: Path = RUNS / "large"
    step: Literal["all", "pack", "stream"] = "all"
    address: str = ""

    @property
    def file(self) -> Path:
        """The city."""
        return self.out / f"city_{self.anchors}.gsyn"


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    if options.step == "pack":
        print(json.dumps(packed(options)))
    elif options.step == "stream":
        print(json.dumps(streamed(options.address)))
    else:
        facts = {"machine": machine().cpu, "commit": short_commit()}
        rows = [{**row, **facts} for row in measured(options)]
        write_rows(CSV, rows)
        if NOTE.exists():
            put(NOTE, __file__, table(rows))


def packed(options: Options) -> Row:
    """Make and write the file; only writing is timed."""
    levels = anchored(options.anchors)
    began = time.perf_counter()
    write_gsyn(levels, options.file, block=options.block, base=options.base)
    return {"seconds": time.perf_counter() - began}


def streamed(address: str) -> Row:
    """All of the file by the policy, nothing drawn."""
    fetcher = Fetcher(ThreadTransport(HttpSource(address)), address)
    session = Session(fetcher, address, SessionOptions(ours, still))
    while not session.complete:
        session.advance(float("inf"))
    events = {event.name: event for event in reversed(session.events)}
    return {"seconds": session.events[-1].time, "opened": events["header"].received}


def measured(options: Options) -> Iterator[Row]:
    """A row for each step."""
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.file
    own = [sys.executable, "-m", "benchmarks.stream.large", "--out", str(options.out)]
    program = [sys.executable, "-m", "gsynopsis"]
    if not file.exists():
        sizes = {name: getattr(options, name) for name in ("anchors", "block", "base")}
        given = [text for name, value in sizes.items() for text in (f"--{name}", str(value))]
        made = child([*own, *given, "--step", "pack"])
        yield row("pack", made, **json.loads(made["said"]))
    yield row("check", child([*program, "check", str(file)]))
    short = options.out / "short.gsyn"
    yield row(
        "cut",
        child([*program, "cut", str(file), "--level", "1", "--out", str(short), "--overwrite"]),
    )
    with serving(make_app(root_of(file), viewer=FOLDER)) as address:
        place = f"{address}/{file.name}"
        made = child([*own, "--step", "stream", "--address", place])
        yield row("stream", made, **json.loads(made["said"]))
        if not MISSING:
            yield from flown(f"{address}/?noui&budget={options.budget}")
    if not MISSING:
        yield looked(options)


def row(step: str, made: Row, **more: Any) -> Row:
    """A row of the CSV; figures that a step does not have are empty."""
    names = ("seconds", "cpu_seconds", "peak_mib", "opened", "bytes", "drawn", "tables")
    found = {**made, **more}
    return {"step": step, **{name: found.get(name, "") for name in names}}


def child(command: Sequence[str]) -> Row:
    """A process: its times, its most memory, and the last line that it prints."""
    began = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    said = process.stdout.read().strip()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"{command}: exit code {process.returncode}")
    return {
        "seconds": time.perf_counter() - began,
        "cpu_seconds": usage.ru_utime + usage.ru_stime,
        "peak_mib": usage.ru_maxrss / 1024,
        "said": said.splitlines()[-1] if said else "",
    }


def flown(url: str) -> Iterator[Row]:
    """State of the viewer at the first view, and after flying over the first houses."""
    steps = [
        {"wait": "complete"},
        {"name": "viewer, first view", "script": STATE},
        {"name": "forward", "script": FORWARD},
        {"name": "viewer, flown forward", "script": STATE},
    ]
    with tempfile.TemporaryDirectory() as folder:
        found = visit(url, Path(folder), steps)
    if found.times("error"):
        sys.exit(f"the viewer: {found.times('error')}")
    done = found.times("complete")[0]["at"] / 1000
    for name in ("viewer, first view", "viewer, flown forward"):
        more = {"seconds": done} if name == "viewer, first view" else {"seconds": ""}
        yield row(name, found.results[name], **more)


def looked(options: Options) -> Row:
    """The first image over a recorded line."""
    given = first_picture.Options([], trace=options.trace, whole=False)
    with tempfile.TemporaryDirectory() as folder:
        found = first_picture.look(options.file, given, Path(folder))
    opened = found["of them the scene's"]
    return row(
        "viewer, first picture", {"seconds": found["first picture"] / 1000, "opened": opened}
    )


def table(rows: Sequence[Row]) -> str:
    """Table of the page."""
    lines = [
        "| step | s | CPU s | peak, MiB | bytes before the first picture | MiB in all | drawn |",
        "|---|---|---|---|---|---|---|",
    ]
    for each in rows:
        memory = each["peak_mib"] or (each["tables"] and each["tables"] / 2**20)
        cells = [
            each["step"],
            each["seconds"] and f"{each['seconds']:.1f}",
            each["cpu_seconds"] and f"{each['cpu_seconds']:.1f}",
            memory and f"{memory:,.0f}",
            each["opened"] and f"{each['opened']:,.0f}",
            each["bytes"] and f"{each['bytes'] / 2**20:.1f}",
            each["drawn"] and f"{each['drawn']:,}",
        ]
        lines.append("| " + " | ".join(str(cell) or "–" for cell in cells) + " |")
    return "\n".join([*lines, "", f"{rows[0]['machine']}, 2 cores, commit {rows[0]['commit']}."])


if __name__ == "__main__":
    main()
