"""A file in our viewer and its streamed SOG in PlayCanvas's own, over the same recorded line.

    gsynopsis export RUN --format ssog --out FOLDER
    python -m benchmarks.interop.streamed RUN/scene.gsyn FOLDER/scene_ssog

A fresh headless Chromium opens each viewer. The line carries the scene's files alone: programs come
as fast as they do. Times are from the first request for the scene: until a canvas shows it, until
each level had been sent, until all had. Needs node, Chromium, `npm ci` in viewer/ and in
benchmarks/interop.
"""

import json
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import tyro
from starlette.applications import Starlette
from starlette.responses import JSONResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Receive, Scope, Send
from tyro.conf import Positional

from benchmarks.bench import RESULTS, TRACES, machine, put, short_commit
from benchmarks.interop.readers import MODULES
from benchmarks.viewer.browser import MISSING, visit
from benchmarks.viewer.first_picture import Noted, Sent
from gsynopsis.container.index import parse_index
from gsynopsis.formats.writers.ssog import INDEX
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.page import FOLDER
from gsynopsis.serve.run import serving
from gsynopsis.serve.shaper import Shaper
from gsynopsis.stream.trace import read_trace
from gsynopsis.stream.virtual import Link

INIT = (Path(__file__).parent / "streamed.js").read_text()
THEIRS = MODULES / "@playcanvas" / "supersplat-viewer" / "public"
PAGE = RESULTS / "streamed_sog.md"
PATIENCE = 180_000


@dataclass(frozen=True)
class Options:
    """What to measure.

    Attributes:
        file: A .gsyn file.
        ssog: Folder with the lod-meta.json of the same file.
        traces: Recorded lines.
        round_trip: Seconds from a request to its answer.
        repeats: Visits to each viewer.
        width: Of the page, pixels.
        height: Of the page, pixels.
    """

    file: Positional[Path]
    ssog: Positional[Path]
    traces: tuple[str, ...] = ("3g_slow", "4g_slow")
    round_trip: float = 0.05
    repeats: int = 3
    width: int = 480
    height: int = 360


class Divided:
    """An application over the line for addresses of the scene, as it is for all others."""

    def __init__(self, app: ASGIApp, link: Link, mark: str) -> None:
        self._plain, self._mark = app, mark
        self.noted = Noted(Shaper(app, link))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer."""
        shaped = scope["type"] == "http" and self._mark in scope["path"]
        await (self.noted if shaped else self._plain)(scope, receive, send)

    def sent(self, part: str = "") -> list[Sent]:
        """What was sent of addresses with a part in them."""
        return [r for r in self.noted.sent if part in r.path and r.amount]


def ours(options: Options, link: Link, folder: Path) -> dict[str, float]:
    """A visit to our viewer."""
    ends = [level.end for level in parse_index(options.file.read_bytes(), "file").levels]
    app = Divided(make_app(root_of(options.file), viewer=FOLDER), link, ".gsyn")
    steps: list[dict[str, Any]] = [{"wait": "complete", "timeout": PATIENCE}]
    with serving(app) as address:
        shown = seen(f"{address}/?noui", steps, options, folder)
    pieces = sorted((at, n) for r in app.sent() for at, n in r.pieces)
    times: dict[str, float] = {}
    for level, end in enumerate(ends):
        total = 0
        for at, amount in pieces:
            total += amount
            if total >= end:
                times[f"L{level} sent"] = at
                break
    return figures(app, shown, times)


def theirs(options: Options, link: Link, folder: Path) -> dict[str, float]:
    """A visit to SuperSplat's viewer."""
    meta = json.loads((options.ssog / INDEX).read_text())
    last = [name for name in meta["filenames"] if name.startswith("0_")]
    wanted = sum(len([*(options.ssog / name).parent.iterdir()]) for name in last)
    routes = [
        Route("/viewer/settings.json", lambda _: JSONResponse(settings(meta))),
        Mount("/viewer", StaticFiles(directory=THEIRS, html=True)),
        Mount("/scene", StaticFiles(directory=options.ssog)),
    ]
    app = Divided(Starlette(routes=routes), link, "/scene/")
    all_there = (
        "performance.getEntriesByType('resource').filter((e) => e.name.includes('/scene/0_')"
        f" && e.responseEnd).length >= {wanted} && globalThis.shown > 0"
    )
    steps: list[dict[str, Any]] = [{"until": all_there, "timeout": PATIENCE}]
    with serving(app) as address:
        url = f"{address}/viewer/?content=/scene/{INDEX}&webgl&noui&noanim&budget=0"
        shown = seen(url, steps, options, folder)
    levels = meta["lodLevels"]
    times = {
        f"L{level} sent": max(r.pieces[-1][0] for r in requests)
        for level in range(levels)
        if (requests := app.sent(f"/{levels - 1 - level}_"))
    }
    return figures(app, shown, times)


def seen(url: str, steps: list[dict[str, Any]], options: Options, folder: Path) -> float:
    """When the scene was first seen, seconds since the epoch."""
    steps = [*steps, {"until": "globalThis.shown > 0"}, {"name": "shown", "script": "shown"}]
    size = (options.width, options.height)
    return visit(url, folder, steps, size, init=INIT).results["shown"] / 1000


def figures(app: Divided, shown: float, times: Mapping[str, float]) -> dict[str, float]:
    """Seconds since the scene was first asked for, and kilobytes."""
    began = min(r.began for r in app.noted.sent)
    before = sum(n for r in app.sent() for at, n in r.pieces if at <= shown)
    return {
        "first picture": shown - began,
        **{name: at - began for name, at in sorted(times.items())},
        "all sent": max(r.pieces[-1][0] for r in app.sent()) - began,
        "kB by the first picture": before / 1000,
        "kB in all": sum(r.amount for r in app.sent()) / 1000,
    }


def settings(meta: Mapping[str, Any]) -> dict[str, Any]:
    """Of SuperSplat's viewer: a camera that looks at the middle from the front, on black."""
    low, high = meta["tree"]["bound"]["min"], meta["tree"]["bound"]["max"]
    middle = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
    reach = max(b - a for a, b in zip(low, high, strict=True))
    eye = [middle[0], middle[1], middle[2] + reach]
    return {
        "camera": {"fov": 50, "position": eye, "target": middle, "startAnim": "none"},
        "background": {"color": [0, 0, 0]},
        "animTracks": [],
    }


def table(found: Mapping[tuple[str, str], list[dict[str, float]]]) -> str:
    """A row for each figure, a column for each line and viewer."""
    names = [*found]
    keys = [*dict.fromkeys(key for visits in found.values() for key in visits[0])]
    keys.sort(key=lambda key: (key.startswith("kB"), key == "all sent"))
    lines = ["| | " + " | ".join(", ".join(name) for name in names) + " |"]
    lines += ["|---" * (len(names) + 1) + "|"]
    for key in keys:
        cells = [value(key, [v[key] for v in found[name] if key in v]) for name in names]
        lines.append(f"| {key} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def value(key: str, values: list[float]) -> str:
    if not values:
        return "never"
    middle = median(values)
    if key.startswith("kB"):
        return f"{middle:,.0f}"
    return f"{middle:.1f} s ({min(values):.1f} … {max(values):.1f})"


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    if MISSING or not THEIRS.is_dir():
        sys.exit(f"no {MISSING or 'benchmarks/interop/node_modules (npm ci)'}: nothing measured")
    found: dict[tuple[str, str], list[dict[str, float]]] = {}
    with tempfile.TemporaryDirectory() as name:
        for trace in options.traces:
            link = Link(read_trace(TRACES / f"{trace}.csv"), options.round_trip)
            for viewer, way in (("ours", ours), ("SuperSplat viewer", theirs)):
                visits = [way(options, link, Path(name)) for _ in range(options.repeats)]
                found[trace, viewer] = visits
                print(trace, viewer, visits, file=sys.stderr, flush=True)
    facts = (
        f"Median of {options.repeats} visits (least … most), page of {options.width} × "
        f"{options.height}; {machine().cpu}, commit {short_commit()}."
    )
    put(PAGE, __file__, f"{table(found)}\n\n{facts}")
    print(table(found))


if __name__ == "__main__":
    main()
