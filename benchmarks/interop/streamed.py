"""A file in our viewer and the same splats in SuperSplat's, over the same recorded lines.

    gsynopsis export RUN --format ssog --out FOLDER
    gsynopsis export RUN --format ply --out FOLDER
    python -m benchmarks.interop.streamed NAME=RUN/scene.gsyn,FOLDER/scene_ssog,FOLDER/scene.ply

The splats go as our levels (streamed SOG), as levels that splat-transform makes of the finest one
(halved three times) and as one SOG. A fresh headless Chromium opens each viewer at
the same place. The line carries the scene's files alone: programs come as fast as they do. Times
are from the first request for the scene. Quality is that of the canvas against the same viewer's
last image, 0 dB before the first one and at most 50. Needs node, Chromium, `npm ci` in viewer/
and in benchmarks/interop.
"""

import json
import math
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from starlette.applications import Starlette
from starlette.responses import JSONResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Receive, Scope, Send
from tyro.conf import Positional

from benchmarks.bench import (
    RESULTS,
    TRACES,
    Row,
    figure_at,
    machine,
    put,
    short_commit,
    stored_rows,
    write_rows,
)
from benchmarks.interop.matrix import write_ssog
from benchmarks.interop.readers import MODULES, splat_transform
from benchmarks.viewer.browser import MISSING, visit
from benchmarks.viewer.first_picture import Noted, Sent
from gsynopsis.formats.readers.ply import read_ply
from gsynopsis.formats.writers.sog import sog_bytes
from gsynopsis.formats.writers.ssog import INDEX
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.page import FOLDER
from gsynopsis.serve.run import serving
from gsynopsis.serve.throttle import Throttle
from gsynopsis.stream.catalog import FULL_DB
from gsynopsis.stream.lookahead import decibels
from gsynopsis.stream.trace import read_trace
from gsynopsis.stream.virtual import Link

INIT = (Path(__file__).parent / "streamed.js").read_text()
THEIRS = MODULES / "@playcanvas" / "supersplat-viewer" / "public"
PAGE = RESULTS / "interop.md"
ROWS, CURVES = (RESULTS / f"streamed_sog.{kind}" for kind in ("csv", "svg"))
TEXT = ("scene", "line", "way", "commit", "machine")
PATIENCE = 160_000
SETTLING = 8_000
"""Milliseconds after the last byte until a viewer's image is final."""
HALVINGS = 3
"""Levels below the finest that splat-transform makes, each with half as many splats."""
OURS = "ours"
WAYS = {
    OURS: "our viewer",
    "levels": "SuperSplat viewer, our levels",
    "tool": "SuperSplat viewer, splat-transform's levels",
    "sog": "SuperSplat viewer, one SOG",
}
SECONDS = (10, 30)
"""Over which quality is averaged."""


@dataclass(frozen=True)
class Options:
    """Options of the comparison.

    Attributes:
        scenes: NAME=FILE,FOLDER,PLY each: a .gsyn file, the folder with its levels' lod-meta.json,
            and its finest level; none: only the page is written again.
        traces: Recorded lines.
        round_trip: Seconds from a request to its answer.
        repeats: Visits of each kind; the one of median quality counts.
        width: Width of the page, pixels.
        height: Height of the page, pixels.
    """

    scenes: Positional[tuple[str, ...]] = ()
    traces: tuple[str, ...] = ("3g_slow", "3g_typical", "puffer_slow", "4g_slow")
    round_trip: float = 0.05
    repeats: int = 1
    width: int = 480
    height: int = 360


class Divided:
    """An application over the line for addresses of the scene, as it is for all others."""

    def __init__(self, app: ASGIApp, link: Link, mark: str) -> None:
        self._plain, self._mark = app, mark
        self.noted = Noted(Throttle(app, link))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer."""
        shaped = scope["type"] == "http" and self._mark in scope["path"]
        await (self.noted if shaped else self._plain)(scope, receive, send)

    def sent(self) -> list[Sent]:
        """Answers with at least one byte."""
        return [r for r in self.noted.sent if r.amount]


@dataclass(frozen=True)
class Seen:
    """A visit: its figures and its quality over time."""

    row: Row
    curve: list[tuple[float, float]]


def ours(file: Path, link: Link, options: Options, folder: Path) -> tuple[Seen, Any]:
    """A visit to our viewer, and where its camera stood."""
    app = Divided(make_app(root_of(file), viewer=FOLDER), link, ".gsyn")
    steps: list[dict[str, Any]] = [
        {"wait": "complete", "timeout": PATIENCE},
        {"name": "camera", "script": "viewer().camera"},
    ]
    with serving(app) as address:
        found = looked(f"{address}/?noui", steps, options, folder)
    return seen(app, found), found["camera"]


def theirs(content: Path, camera: Any, link: Link, options: Options, folder: Path) -> Seen:
    """A visit to SuperSplat's viewer, of a folder with streamed SOG or of one file."""
    if content.is_dir():
        names = [n for n in json.loads((content / INDEX).read_text())["filenames"] if n[0] == "0"]
        wanted, mark, index = (
            sum(len([*(content / n).parent.iterdir()]) for n in names),
            "0_",
            INDEX,
        )
        files = content
    else:
        wanted, mark, index, files = 1, "", content.name, content.parent
    routes = [
        Route("/viewer/settings.json", lambda _: JSONResponse(settings(camera, options))),
        Mount("/viewer", StaticFiles(directory=THEIRS, html=True)),
        Mount("/scene", StaticFiles(directory=files)),
    ]
    app = Divided(Starlette(routes=routes), link, "/scene/")
    there = (
        f"performance.getEntriesByType('resource').filter((e) => e.name.includes('/scene/{mark}')"
        f" && e.responseEnd).length >= {wanted}"
    )
    steps: list[dict[str, Any]] = [{"until": there, "timeout": PATIENCE}]
    with serving(app) as address:
        url = f"{address}/viewer/?content=/scene/{index}&webgl&noui&noanim&budget=0"
        return seen(app, looked(url, steps, options, folder))


def looked(
    url: str, steps: list[dict[str, Any]], options: Options, folder: Path
) -> Mapping[str, Any]:
    """Results of the page once its image is final."""
    steps = [*steps, {"sleep": SETTLING}, {"until": "still()"}]
    steps += [{"name": "quality", "script": "quality()"}, {"name": "shown", "script": "shown"}]
    return visit(url, folder, steps, (options.width, options.height), init=INIT).results


def seen(app: Divided, found: Mapping[str, Any]) -> Seen:
    """Seconds since the scene was first asked for, kilobytes, and quality over time."""
    began = min(r.began for r in app.noted.sent)
    shown = found["shown"] / 1000
    moments, errors = np.array(found["quality"]).T
    curve = [*zip((moments / 1000 - began).tolist(), decibels(errors).tolist(), strict=True)]
    curve[0] = (shown - began, curve[0][1])
    row: Row = {
        "first_picture": shown - began,
        **{f"db_{seconds}": mean_quality(curve, seconds) for seconds in SECONDS},
        "last_picture": next(at for at, value in curve if value >= FULL_DB),
        "all_sent": max(r.pieces[-1][0] for r in app.sent()) - began,
        "kb_first": sum(n for r in app.sent() for at, n in r.pieces if at <= shown) / 1000,
        "kb": sum(r.amount for r in app.sent()) / 1000,
    }
    return Seen(row, curve)


def mean_quality(curve: Sequence[tuple[float, float]], seconds: float) -> float:
    """Mean dB over the first seconds; each image stays until the next, before the first is 0."""
    steps = [*curve, (max(seconds, curve[-1][0]), curve[-1][1])]
    held = [(min(b, seconds) - min(a, seconds)) * value for (a, value), (b, _) in pairwise(steps)]
    return sum(held) / seconds


def settings(camera: Mapping[str, Any], options: Options) -> dict[str, Any]:
    """Settings of SuperSplat's viewer: our camera in its axes, on black."""

    def turned(place: Sequence[float]) -> list[float]:
        """Splats are shown half a turn around z from where they are."""
        return [-place[0], -place[1], place[2]]

    ratio = max(options.width, options.height) / min(options.width, options.height)
    across = 2 * math.degrees(math.atan(ratio * math.tan(camera["fov"] / 2)))
    place = {name: turned(camera[name]) for name in ("position", "target")}
    return {
        "camera": {"fov": across, **place, "startAnim": "none"},
        "background": {"color": [0, 0, 0]},
        "animTracks": [],
    }


def tool_levels(ply: Path, folder: Path) -> Path:
    """A streamed SOG of levels that splat-transform makes, coded as ours are."""
    levels = [read_ply(ply).levels[-1]]
    for level in range(1, HALVINGS + 1):
        half = folder / f"half{level}.ply"
        splat_transform(ply, "--decimate", f"{100 / 2**level:g}%", half).check_returncode()
        levels.insert(0, read_ply(half).levels[-1])
    return write_ssog(levels, folder / "tool").parent


def one_sog(ply: Path, folder: Path) -> Path:
    """All of it as one SOG."""
    found = folder / "one" / "scene.sog"
    found.parent.mkdir()
    found.write_bytes(sog_bytes(read_ply(ply).levels[-1]))
    return found


def measure(name: str, paths: Sequence[Path], options: Options) -> tuple[list[Row], list[Any]]:
    """All visits for a scene; rows, and the curves of each line."""
    file, levels, ply = paths
    rows: list[Row] = []
    curves: list[Any] = []
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        contents = {"levels": levels, "tool": tool_levels(ply, folder), "sog": one_sog(ply, folder)}
        for trace in options.traces:
            link = Link(read_trace(TRACES / f"{trace}.csv"), options.round_trip)
            visits = [ours(file, link, options, folder) for _ in range(options.repeats)]
            camera = visits[0][1]
            found = {OURS: middle([visit for visit, _ in visits])}
            for way, content in contents.items():
                found[way] = middle(
                    [theirs(content, camera, link, options, folder) for _ in range(options.repeats)]
                )
            for way, each in found.items():
                about = {"scene": name, "line": trace, "way": way, "visits": options.repeats}
                made = {"commit": short_commit(), "machine": machine().cpu}
                rows.append({**about, **each.row, **made})
                print(rows[-1], file=sys.stderr, flush=True)
            curves.append({way: each.curve for way, each in found.items()})
    return rows, curves


def middle(visits: Sequence[Seen]) -> Seen:
    """The visit of median quality."""
    return sorted(visits, key=lambda each: each.row["db_10"])[len(visits) // 2]


def summary(rows: Sequence[Row]) -> str:
    """Lead of ours over each other way after ten seconds, least and most of all lines."""
    parts: list[str] = []
    for way, name in WAYS.items():
        if way == OURS:
            continue
        ahead = [
            mine["db_10"] - row["db_10"]
            for row in rows
            for mine in rows
            if row["way"] == way
            and mine["way"] == OURS
            and (row["scene"], row["line"]) == (mine["scene"], mine["line"])
        ]
        parts.append(f"{name} by {min(ahead):.1f} to {max(ahead):.1f} dB")
    return f"Over the first ten seconds ours is ahead of {'; '.join(parts)}."


def draw(found: Mapping[str, Mapping[str, Mapping[str, list[tuple[float, float]]]]]) -> None:
    """A panel for each scene and line: quality over time."""
    panels = [(s, t, ways) for s, lines in found.items() for t, ways in lines.items()]
    rows = math.ceil(len(panels) / 2)
    with figure_at(CURVES, 9, 2.6 * rows) as figure:
        axes = figure.subplots(rows, 2, squeeze=False, sharey=True)
        for place, (scene, trace, ways) in zip(axes.flat, panels, strict=False):
            for way, curve in ways.items():
                times, values = zip(*[(0.0, 0.0), *curve], strict=True)
                width = 2.5 if way == OURS else 1.2
                place.step(times, values, where="post", label=WAYS[way], linewidth=width)
            place.set(title=f"{scene}, {trace}", xlim=(0, 30), ylim=(0, FULL_DB + 1))
            place.set(xlabel="seconds", ylabel="dB to the last picture")
        axes[0, 0].legend(fontsize=7, loc="lower right")


def main() -> None:
    """Measure, write."""
    options = tyro.cli(Options, description=__doc__)
    if options.scenes:
        if MISSING or not THEIRS.is_dir():
            sys.exit(
                f"no {MISSING or 'benchmarks/interop/node_modules (npm ci)'}: nothing measured"
            )
        rows: list[Row] = []
        curves: dict[str, Any] = {}
        for text in options.scenes:
            name, _, paths = text.partition("=")
            more, drawn = measure(name, [Path(path) for path in paths.split(",")], options)
            rows += more
            curves[name] = dict(zip(options.traces, drawn, strict=True))
        write_rows(ROWS, rows)
        draw(curves)
    rows = stored_rows(ROWS, TEXT)
    commits = ", ".join(dict.fromkeys(row["commit"] for row in rows))
    facts = f"{rows[0]['machine']}, commit {commits}; visits of each kind: {rows[0]['visits']}."
    figure = f"![Quality over time]({CURVES.name})"
    put(PAGE, __file__, "\n\n".join([figure, summary(rows), facts]))
    print(f"wrote {PAGE.relative_to(PAGE.parents[2])}")


if __name__ == "__main__":
    main()
