"""Photos at their stored size: docs/results/quality.md from finished suites and their files.

    python -m research suites/full_size.toml --data DATA --out FULL
    python -m research suites/steps.toml --data DATA --out STEPS
    python -m benchmarks.train.full_size --scenes FULL --steps STEPS

Copies the rows of the suites into docs/results/full_size.csv and full_size_steps.csv and draws what
minutes buy; plays each scene's file over recorded lines and opens it in Chromium, into
docs/results/full_size_lines.csv. Without a folder what is there stays; the page is written anew.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import tyro

from benchmarks.bench import (
    RESULTS,
    ROOT,
    TRACES,
    Row,
    figure_at,
    put,
    stored_rows,
    table_of,
    write_rows,
)
from benchmarks.train.cells import MIB, made_by
from benchmarks.viewer.browser import MISSING
from benchmarks.viewer.first_picture import Options as Visit
from benchmarks.viewer.first_picture import look

PAGE = RESULTS / "quality.md"
README = ROOT / "README.md"
ROWS = RESULTS / "full_size.csv"
STEPS = RESULTS / "full_size_steps.csv"
LINES = RESULTS / "full_size_lines.csv"
CURVE = RESULTS / "full_size.svg"
TEXT = ("scene", "method", "split", "version", "commit", "machine", "line")
PLAYED = ("3g_slow", "4g_slow", "5g_slow")
VISITS = 3


@dataclass(frozen=True)
class Options:
    """Options of the page.

    Attributes:
        scenes: Folder of the finished suite of scenes; none: the rows that are there.
        steps: Likewise of the suite of steps.
    """

    scenes: Path | None = None
    steps: Path | None = None


def played(file: Path, line: str) -> Row:
    """A file over a recorded line: on a virtual clock, and in Chromium."""
    trace = TRACES / f"{line}.csv"
    with tempfile.TemporaryDirectory() as folder:
        words = [sys.executable, "-m", "gsynopsis", "stream", str(file), "--trace", str(trace)]
        words += ["--out", folder, "--json", "--quiet"]
        said = json.loads(subprocess.run(words, check=True, capture_output=True).stdout)
        shown: list[float] = []
        if not MISSING:
            visits = range(VISITS)
            shown = [look(file, Visit([], trace), Path(folder))["first picture"] for _ in visits]
    return {
        "line": line,
        "bytes": said["received_bytes"],
        "first_picture_s": round(said["first_picture_s"], 3),
        "complete_s": round(said["finished_s"], 3),
        "viewed_10s_db": round(said["viewed_10s_db"], 2),
        "chromium_first_s": round(median(shown) / 1000, 3) if shown else "",
    }


def lines_of(folder: Path, method: str) -> Iterator[Row]:
    """Each scene's file over each line."""
    for cell in sorted((folder / "cells").iterdir()):
        scene, found, _ = cell.name.split("-", 2)
        if found == method and (cell / "scene.gsyn").exists():
            for line in PLAYED:
                yield {"scene": scene, **played(cell / "scene.gsyn", line)}


def level_table(rows: Sequence[Row]) -> str:
    """One line a scene, for the page: photos, levels, and what the training took."""
    heads = ["scene", "pixels", "photos for training / test"]
    heads += [*(f"L{k}, dB in MiB" for k in range(4)), "CPU minutes", "memory, MiB"]
    lines = list[list[str]]()
    for first in (row for row in rows if not row["level"]):
        own = [row for row in rows if row["scene"] == first["scene"]]
        levels = [f"{r['psnr_full']:.2f} in {r['bytes_compact'] / MIB:.3f}" for r in own]
        head = [str(first["scene"]), f"{first['width']} × {first['height']}", _photos(first)]
        took = [f"{first['cpu_seconds'] / 60:.0f}", f"{first['peak_mib']:,.0f}"]
        lines.append([*head, *levels, *took])
    return table_of(heads, lines)


def short_table(rows: Sequence[Row]) -> str:
    """One line a scene, for the README."""
    lines = list[list[str]]()
    for first in (row for row in rows if not row["level"]):
        own = [row for row in rows if row["scene"] == first["scene"]]
        cells = [f"{r['bytes_compact'] / MIB:.2f} MiB, {r['psnr_full']:.2f} dB" for r in own]
        head = [str(first["scene"]), f"{first['width']} × {first['height']}"]
        lines.append([*head, *cells])
    return table_of(["scene", "pictures", "L0", "L1", "L2", "L3"], lines)


PHOTOS = {"fox": 50, "bonsai": 289, "brighton": 18}
"""Number of the scenes' photos, held-out ones included."""


def _photos(row: Row) -> str:
    return f"{PHOTOS[row['scene']] - row['test_photos']} / {row['test_photos']}"


def draw(rows: Sequence[Row]) -> None:
    """Draw quality against minutes, a line for each level."""
    with figure_at(CURVE, 6, 3.6) as figure:
        axes = figure.add_subplot()
        for level in sorted({row["level"] for row in rows}):
            own = sorted(
                (r["cpu_seconds"] / 60, r["psnr_full"]) for r in rows if r["level"] == level
            )
            axes.plot(*zip(*own, strict=True), marker="o", markersize=4, label=f"L{level}")
        axes.set(xlabel="CPU minutes", ylabel="PSNR, dB", xlim=(0, None))
        axes.legend()
        axes.grid(alpha=0.3)


def main() -> None:
    """Gather, measure, write."""
    options = tyro.cli(Options, description=__doc__)
    if options.scenes is not None:
        write_rows(ROWS, stored_rows(options.scenes / "results.csv", TEXT))
        write_rows(LINES, list(lines_of(options.scenes, "standard")))
    if options.steps is not None:
        write_rows(STEPS, stored_rows(options.steps / "results.csv", TEXT))
    rows, steps = stored_rows(ROWS, TEXT), stored_rows(STEPS, TEXT)
    made, drawn = made_by(rows), made_by(steps)  # before anything is written
    draw(steps)
    put(PAGE, __file__, f"{level_table(rows)}\n\nSeed 0, {made}.")
    picture = "![What minutes of a CPU buy](full_size.svg)"
    put(PAGE, __file__, f"{picture}\n\nSeed 0, {drawn}.", part="steps")
    put(README, __file__, short_table(rows))
    print(PAGE, README, sep="\n")


if __name__ == "__main__":
    main()
