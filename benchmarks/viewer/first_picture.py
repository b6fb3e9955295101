"""Time without an image for a newcomer: the viewer's page over a recorded slow line, cache empty.

    python -m benchmarks.viewer.first_picture demo=runs/demo/run/scene.gsyn

A fresh Chromium opens the address that `gsynopsis serve FILE --trace TRACE` prints, against the
same application; the recorded line begins with its first request. Printed are milliseconds since
the navigation, median of the visits, until each step on the way to the first image: pixels of the
scene on screen, checked; with a base of several blocks it is that of the first. Each byte of the
file may be sent once, in every visit to its end. Needs node, Chromium and `npm ci` in viewer/.
"""

import json
import sys
import tempfile
import time
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

import tyro
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from tyro.conf import Positional

from benchmarks.bench import TRACES
from benchmarks.viewer.browser import MISSING, visit
from gsynopsis.container.index import parse_index
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.page import FOLDER
from gsynopsis.serve.run import serving
from gsynopsis.stream.trace import read_trace
from gsynopsis.stream.virtual import Link

TRACE = TRACES / "3g_slow.csv"
HERE = Path(__file__).parent
INIT = "".join((HERE / name).read_text() for name in ("listen.js", "first_picture.js"))


@dataclass(frozen=True)
class Options:
    """Options of the measurement.

    Attributes:
        files: NAME=FILE, a .gsyn file each.
        trace: The recorded line.
        round_trip: Seconds from a request to its answer.
        repeats: Visits.
        width: Width of the page, pixels.
        height: Height of the page, pixels.
        json: Print all figures as JSON.
        whole: Each visit loads all of the file; else it ends with the base.
    """

    files: Positional[list[str]]
    trace: Path = TRACE
    round_trip: float = 0.05
    repeats: int = 5
    width: int = 600
    height: int = 450
    json: bool = False
    whole: bool = True


@dataclass
class Sent:
    """A request as the server saw it, seconds since the epoch."""

    path: str
    first: int
    began: float
    pieces: list[tuple[float, int]] = field(default_factory=list)

    @property
    def amount(self) -> int:
        """Bytes of the body."""
        return sum(amount for _, amount in self.pieces)

    def time_of(self, amount: int) -> float:
        """Time at which `amount` bytes had been sent; infinite if never."""
        total = 0
        for at, piece in self.pieces:
            total += piece
            if total >= amount:
                return at
        return float("inf")


class Noted:
    """An application whose requests are noted."""

    def __init__(self, app: ASGIApp) -> None:
        self._app, self.sent = app, list[Sent]()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer as the application does, and note it."""
        wanted = Headers(scope=scope).get("range", "bytes=0-")
        first = int(wanted.removeprefix("bytes=").split("-")[0])
        note = Sent(scope["path"], first, time.time())
        self.sent.append(note)

        async def noted(message: Message) -> None:
            body = message.get("body", b"")
            if body:
                note.pieces.append((time.time(), len(body)))
            await send(message)

        await self._app(scope, receive, noted)


def check_once(requests: list[Sent], size: int, *, whole: bool) -> None:
    """No byte of the file was sent twice, and all of it if the `whole` is wanted."""
    spans = sorted((r.first, r.first + r.amount) for r in requests if r.amount)
    once = all(a[1] == b[0] if whole else a[1] <= b[0] for a, b in pairwise(spans))
    if not once or spans[0][0] != 0 or (whole and spans[-1][1] != size):
        sys.exit(f"bytes were not sent once each: {spans} of {size}")


def base_sent(requests: list[Sent], base: int) -> float:
    """When the last byte of the base was sent, seconds since the epoch."""
    parts = [r for r in requests if r.amount and r.first < base]
    return max(r.time_of(min(r.amount, base - r.first)) for r in parts)


def look(file: Path, options: Options, folder: Path) -> dict[str, float]:
    """One visit: milliseconds since the navigation to each step, and bytes sent by then."""
    data = file.read_bytes()
    base = parse_index(data, file.name).levels[0].end
    link = Link(read_trace(options.trace), options.round_trip)
    noted = Noted(make_app(root_of(file), viewer=FOLDER, link=link))
    end = "complete" if options.whole else "base-ready"
    steps: list[dict[str, Any]] = [{"wait": end}, {"name": "facts", "script": "facts()"}]
    with serving(noted) as address:
        seen = visit(f"{address}/", folder, steps, (options.width, options.height), init=INIT)
    facts = seen.results["facts"]
    scenes = [r for r in noted.sent if r.path.endswith(".gsyn")]
    check_once(scenes, len(data), whole=options.whole)
    script = next(r for r in noted.sent if r.path.endswith("-viewer.js") and r.amount)
    page = facts["origin"] - facts["began"]
    shown = page + facts["first"]
    heard = facts["heard"]

    def said(kind: str) -> float:
        return page + next(m["at"] for m in heard if m["type"] == kind)

    def server(seconds: float) -> float:
        return 1000 * seconds - facts["began"]

    by_then = facts["began"] / 1000 + shown / 1000
    amounts = {
        name: sum(n for r in requests for at, n in r.pieces if at <= by_then)
        for name, requests in (("all", noted.sent), ("scene", scenes))
    }
    return {
        "page asked for": server(noted.sent[0].began),
        "script asked for": server(script.began),
        "scene asked for": server(scenes[0].began),
        "script sent": server(script.pieces[-1][0]),
        "script runs": page + facts["defined"],
        "decoder runs": said("started"),
        "header read": said("header"),
        "first block decoded": said("attributes"),
        "first picture": shown,
        "base sent": server(base_sent(scenes, base)),
        "base on screen": page + seen.times("base-ready")[0]["at"],
        "bytes of the script": script.amount,
        "bytes of the base": base,
        "bytes sent by the first picture": amounts["all"],
        "of them the scene's": amounts["scene"],
        "share of pixels lit by it, %": 100 * facts["firstLit"],
        "share of pixels lit by the base, %": 100 * facts["lit"],
    }


def table(found: dict[str, dict[str, list[float]]]) -> str:
    """All scenes' medians side by side."""
    names = list(found)
    rows = list(found[names[0]])
    lines = [
        "| ms since the navigation, median (least … most) | " + " | ".join(names) + " |",
        "|---" * (1 + len(names)) + "|",
    ]
    for row in rows:
        cells = []
        for name in names:
            values = found[name][row]
            middle = f"{median(values):,.0f}"
            spread = f" ({min(values):,.0f} … {max(values):,.0f})"
            cells.append(middle if row.startswith(("bytes", "of", "share")) else middle + spread)
        lines.append(f"| {row} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    if MISSING:
        sys.exit(f"no {MISSING}: nothing measured")
    found: dict[str, dict[str, list[float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for text in options.files:
            name, _, file = text.partition("=")
            visits = [look(Path(file), options, Path(folder)) for _ in range(options.repeats)]
            found[name] = {row: [each[row] for each in visits] for row in visits[0]}
            print(f"{name}: {median(found[name]['first picture']):.0f} ms", file=sys.stderr)
    print(json.dumps(found, indent=1) if options.json else table(found))


if __name__ == "__main__":
    sys.exit(main())
