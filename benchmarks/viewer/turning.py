"""The draw order while the camera turns by half a circle in half a second, as CSV.

    python -m benchmarks.viewer.turning

Of each frame: how many frames ago the camera was that its order is for (WebGL 2, which sorts in a
worker; nobody is told of WebGPU's), and dB to the same view once it is sorted. The splats are
a made-up city. Chromium draws with SwiftShader, on the CPU: frames are as few as that allows.
"""

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import tyro

from benchmarks.bench import RESULTS, RUNS, Row, machine, short_commit, write_rows
from benchmarks.viewer.browser import MISSING, pages, visit
from benchmarks.viewer.city import files_of

CSV = RESULTS / "turning.csv"
SCRIPT = Path(__file__).with_suffix(".js")
RENDERERS = {"WebGL 2": "", "WebGPU": "&renderer=webgpu"}


@dataclass(frozen=True)
class Options:
    """Options of the measurement.

    Attributes:
        count: Splats of the city.
        seconds: Of a turn; slower ones have frames where the device draws few.
        repeats: Turns of each renderer.
        width: Width of the canvas, pixels.
        height: Height of the canvas, pixels.
        out: Folder in which the files stay.
    """

    count: int = 20_000
    seconds: tuple[float, ...] = (0.5,)
    repeats: int = 3
    width: int = 160
    height: int = 90
    out: Path = RUNS / "city"


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    if MISSING:
        sys.exit(f"no {MISSING}: nothing measured")
    _, file = files_of(options.count, options.out)
    rows = [turned(file, name, each, options) for each in options.seconds for name in RENDERERS]
    write_rows(CSV, rows)


def turned(file: Path, renderer: str, seconds: float, options: Options) -> Row:
    """All frames of some turns."""
    steps: list[dict[str, Any]] = [{"wait": "complete"}, {"until": "viewer().tools !== null"}]
    steps += [{"name": f"{k}", "script": f"turned({seconds})"} for k in range(options.repeats)]
    with tempfile.TemporaryDirectory() as folder, pages(file) as address:
        url = f"{address}/?noui{RENDERERS[renderer]}"
        context = {"webgpu": renderer == "WebGPU"}
        size = (options.width, options.height)
        found = visit(url, Path(folder), steps, size, init=SCRIPT.read_text(), context=context)
    assert not found.times("error"), found.said
    turns = [found.results[f"{k}"] for k in range(options.repeats)]
    frames = [frame for turn in turns for frame in turn]
    late = [frame["late"] for frame in frames if frame["late"] is not None]
    row: Row = {
        "renderer": renderer,
        "seconds": seconds,
        "splats": options.count,
        "turns": len(turns),
        "frames_a_turn": round(len(frames) / len(turns), 1),
        "late_median": median(late) if late else "",
        "late_most": max(late, default=""),
        "db_median": round(median(frame["db"] for frame in frames), 1),
        "db_least": round(min(frame["db"] for frame in frames), 1),
        "width": options.width,
        "height": options.height,
        "device": "SwiftShader, not a GPU",
        "machine": machine().cpu,
        "commit": short_commit(),
    }
    print(row)
    return row


if __name__ == "__main__":
    main()
