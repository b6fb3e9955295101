"""Our viewer, Spark and PlayCanvas beside each other with 1, 3 and 5 million splats, as CSV.

    python -m benchmarks.viewer.size

The splats are a made-up city (benchmarks/viewer/city.py): our file has four levels, the others get
the same splats as SOG. PlayCanvas leaves out what is smaller than two pixels unless it is told not
to: it comes both ways, and the last picture of each flight has its PSNR to the CPU renderer's of
all splats beside it. Each viewer runs by itself in one headless Chromium that draws with
SwiftShader, on the CPU, so a frame's time is that of the graphics device in software and counts
only beside another one's. Needs node, Chromium and `npm ci` in viewer/ and in benchmarks/interop.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import tyro

from benchmarks.bench import (
    RESULTS,
    ROOT,
    RUNS,
    Row,
    machine,
    put,
    short_commit,
    stored_rows,
    write_rows,
)
from benchmarks.viewer.browser import CHROMIUM, MISSING, pages, psnr, screenshot
from benchmarks.viewer.city import files_of
from benchmarks.viewer.node import NODE
from gsynopsis.formats.readers.any import read_splats
from gsynopsis.formats.writers.sog import sog_bytes
from gsynopsis.jobs.splat_views import painted
from gsynopsis.model.splats import SplatModel
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import Camera
from gsynopsis.serve.page import FOLDER

HERE = Path(__file__).parent
INTEROP = ROOT / "benchmarks" / "interop"
CSV, NOTE = RESULTS / "viewer_size.csv", RESULTS / "viewer.md"
TEXT = ("viewer", "state", "said", "machine", "commit")
NAMES = {
    "ours": "ours",
    "spark": "Spark",
    "playcanvas": "PlayCanvas",
    "playcanvas_all": "PlayCanvas, all drawn",
}
PATHS = ("around", "street")
MIB = 2**20


@dataclass(frozen=True)
class Options:
    """Options of the measurement.

    Attributes:
        counts: Splats, millions; parts of one too.
        only: Viewers.
        state: Name of our viewer's state, if several are compared, as `before`.
        viewer: Folder of our built viewer.
        budget: Most splats that ours renders.
        width: Width of the canvas, pixels.
        height: Height of the canvas, pixels.
        frames: Timed frames on each path.
        repeats: Visits; of each figure the median counts.
        out: Folder in which files and images stay; existing files are not made again.
    """

    counts: tuple[float, ...] = (1, 3, 5)
    only: tuple[str, ...] = tuple(NAMES)
    state: str = ""
    viewer: Path = FOLDER
    budget: int = 10_000_000
    width: int = 320
    height: int = 180
    frames: int = 8
    repeats: int = 1
    out: Path = RUNS / "city"


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    lacking = MISSING or ("" if (INTEROP / "node_modules").is_dir() else "benchmarks/interop npm")
    if lacking:
        sys.exit(f"no {lacking}: nothing measured")
    commit = short_commit()
    rows = stored_rows(CSV, TEXT) if CSV.exists() else []
    rows = [row for row in rows if row["commit"] == commit]
    for row in measured(options, commit):
        print(row, file=sys.stderr, flush=True)
        key = (row["splats"], row["viewer"], row["state"])
        rows = [r for r in rows if (r["splats"], r["viewer"], r["state"]) != key] + [row]
        rows.sort(key=lambda r: (r["splats"], [*NAMES.values()].index(r["viewer"]), r["state"]))
        write_rows(CSV, rows)
        if NOTE.exists():
            put(NOTE, __file__, table(rows))


def measured(options: Options, commit: str) -> Iterator[Row]:
    """A row for each number of splats and each viewer."""
    for millions in options.counts:
        count = round(millions * 1_000_000)
        plain, ours = files_of(count, options.out)
        model = SplatModel(read_splats(plain).levels[-1])
        for engine in options.only:
            path = ours if engine == "ours" else sog_of(plain)
            visits = [visited(options, engine, path) for _ in range(options.repeats)]
            yield {
                "splats": count,
                "viewer": NAMES[engine],
                "state": options.state if engine == "ours" else "",
                "bytes": path.stat().st_size,
                **joined(visits),
                **nearness(options, engine, path, model, visits[-1]),
                "visits": options.repeats,
                "width": options.width,
                "height": options.height,
                "machine": machine().cpu,
                "commit": commit,
            }


def sog_of(plain: Path) -> Path:
    """The same splats as SOG, beside the PLY."""
    path = plain.with_suffix(".sog")
    if not path.exists():
        path.write_bytes(sog_bytes(read_splats(plain).levels[-1]))
    return path


def nearness(
    options: Options, engine: str, path: Path, model: SplatModel, visit: dict[str, Any]
) -> Row:
    """PSNR of a visit's last picture of each flight to the CPU renderer's of all splats, dB."""
    row: Row = {}
    for flight in PATHS:
        if "error" in visit:
            row[f"{flight}_db"] = ""
            continue
        told = visit[f"{flight}_camera"]
        w2c = np.vstack([np.reshape(told["w2c"], (3, 4)), [0, 0, 0, 1]])
        truth = painted(model, 0, Camera(**{**told, "w2c": w2c}), CpuRenderer())
        shot = screenshot(options.out / f"{engine}_{path.stem}_{flight}.png")
        row[f"{flight}_db"] = round(psnr(shot, truth / 255), 1)
    return row


def joined(visits: Sequence[dict[str, Any]]) -> Row:
    """Medians over visits, of frames over all of theirs."""
    said = "; ".join({visit["error"] for visit in visits if "error" in visit})
    good = [visit for visit in visits if "error" not in visit]
    row: Row = {}
    triangles = [f"{path}_triangles" for path in PATHS]
    for name in ("drawn", "first_s", "loaded_s", "all_s", "peak_mib", "gpu_mib", *triangles):
        row[name] = round(median(v[name] for v in good), 2) if good else ""
    for path in PATHS:
        frames = [frame for visit in good for frame in visit[path]]
        row[f"{path}_ms"] = round(median(frames), 1) if frames else ""
    return {**row, "said": said}


def visited(
    options: Options,
    engine: str,
    path: Path,
    paths: Sequence[str] = PATHS,
    tour: Sequence[Sequence[Sequence[float]]] = (),
) -> dict[str, Any]:
    """Results of one visit of a viewer to a file: its flights, then stops of a tour of ours."""
    job = {
        "name": f"{engine}_{path.stem}",
        "engine": engine.removesuffix("_all"),
        **({"least": 0} if engine.endswith("_all") else {}),
        "format": path.suffix[1:],
        "width": options.width,
        "height": options.height,
        "fov": 0.9,
        "frames": options.frames,
        "patience": 240_000,
        "paths": paths,
        "tour": tour,
    }
    with pages(options.out, options.viewer) as address, tempfile.TemporaryDirectory() as folder:
        query = f"?noui&budget={options.budget}&content={path.name}"
        request = {
            "chromium": CHROMIUM,
            "interop": str(INTEROP),
            "files": str(options.out.resolve()),
            "folder": folder,
            "out": str(options.out.resolve()),
            "job": {**job, "url": f"{address}/{query}" if engine == "ours" else path.name},
        }
        asked = Path(folder) / "request.json"
        asked.write_text(json.dumps(request))
        command = [str(NODE), str(HERE / "size.mjs"), str(asked)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0 and done.stdout, done.stderr[-2000:]
    return json.loads(done.stdout)


def table(rows: Sequence[Row]) -> str:
    """The note's table."""
    lines = [
        "| splats | viewer | file, MiB | drawn | first picture, s | picture complete, s "
        "| all in view, ms a frame | in a street, ms a frame | dB to all splats, all in view "
        "| in a street | peak memory, MiB |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        name = " ".join(filter(None, (row["viewer"], row["state"])))
        if row["said"]:
            cells = [row["said"], *[""] * 7]
        else:
            cells = [f"{row['drawn']:,.0f}", *(f"{row[k]:.1f}" for k in ("first_s", "all_s"))]
            cells += [f"{row[k]:,.0f}" for k in ("around_ms", "street_ms")]
            cells += [f"{row[k]:.1f}" if row[k] else "" for k in ("around_db", "street_db")]
            cells += [f"{row['peak_mib']:,.0f}"]
        first = [f"{row['splats']:,}", name, f"{row['bytes'] / MIB:.1f}"]
        lines.append(f"| {' | '.join([*first, *cells])} |")
    made = {(row["machine"], row["width"], row["height"], row["commit"]) for row in rows}
    if len(made) != 1:
        sys.exit(f"rows are not of one commit, machine and size of picture: measure all: {made}")
    cpu, width, height, commit = made.pop()
    fewest, most = (pick(int(row["visits"]) for row in rows) for pick in (min, max))
    where = f"{cpu}, headless Chromium with SwiftShader, {width} × {height} pixels"
    visits = f"{most}" if fewest == most else f"{fewest} to {most}"
    seen = "one visit" if most == 1 else f"{visits} visits"
    return "\n".join([*lines, "", f"{where}, {seen} each, commit {commit}."])


if __name__ == "__main__":
    main()
