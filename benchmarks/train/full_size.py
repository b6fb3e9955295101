"""Photos at their stored size: docs/results/full_size.md from finished suites and their files.

    python -m research suites/full_size.toml --out FULL
    python -m research suites/steps.toml --out STEPS
    python -m benchmarks.train.full_size FULL STEPS

Copies the rows of both suites into docs/results/full_size.csv and draws what minutes buy; plays
each scene's file over recorded lines and opens it in Chromium, into
docs/results/full_size_lines.csv. Without folders the page is written again from those two.
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
from tyro.conf import Positional

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

PAGE = RESULTS / "full_size.md"
README = ROOT / "README.md"
ROWS = RESULTS / "full_size.csv"
LINES = RESULTS / "full_size_lines.csv"
CURVE = RESULTS / "full_size.svg"
TEXT = ("scene", "method", "split", "version", "commit", "machine", "line")
PLAYED = ("3g_slow", "4g_slow", "5g_slow")
VISITS = 3


@dataclass(frozen=True)
class Options:
    """Options of the page.

    Attributes:
        folders: Folders of finished suites, scenes first; none: the page alone.
    """

    folders: Positional[tuple[Path, ...]] = ()


def gathered(folders: Sequence[Path]) -> list[Row]:
    """Rows of all suites, those of a cell that two of them have once."""
    known: dict[tuple[object, ...], Row] = {}
    for folder in folders:
        for row in stored_rows(folder / "results.csv", TEXT):
            known.setdefault((row["scene"], row["method"], row["seed"], row["level"]), row)
    return list(known.values())


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
    """Scenes and levels."""
    heads = ["scene", "pixels", "photos for training / test", "level", "PSNR, dB", "SSIM", "FLIP"]
    heads += ["MiB", "anchors", "CPU minutes", "memory, MiB"]
    lines = list[list[str]]()
    for row in rows:
        first = not row["level"]
        head = (
            [row["scene"], f"{row['width']} × {row['height']}", _photos(row)] if first else [""] * 3
        )
        tail = [f"{row['cpu_seconds'] / 60:.0f}", f"{row['peak_mib']:,.0f}"] if first else ["", ""]
        figures = [
            *(f"{row['psnr_full']:.2f}", f"{row['ssim_full']:.3f}", f"{row['flip_full']:.3f}"),
            *(f"{row['bytes_compact'] / MIB:.3f}", f"{row['anchors']:,}"),
        ]
        lines.append([*head, f"L{row['level']}", *figures, *tail])
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


def steps_table(rows: Sequence[Row]) -> str:
    """Table of quality against steps."""
    heads = ["fox, steps", "CPU minutes", "L0", "L1", "L2", "L3, dB", "L3, MiB"]
    lines = list[list[str]]()
    by_method: dict[str, list[Row]] = {}
    for row in rows:
        by_method.setdefault(row["method"], []).append(row)
    for method, levels in sorted(by_method.items(), key=lambda item: item[1][0]["cpu_seconds"]):
        db = [f"{row['psnr_full']:.2f}" for row in levels]
        minutes = f"{levels[0]['cpu_seconds'] / 60:.0f}"
        size = f"{levels[-1]['bytes_compact'] / MIB:.3f}"
        lines.append([STEPS[method], minutes, *db, size])
    return table_of(heads, lines)


STEPS = {
    "fast, a quarter": "1,000",
    "fast, half": "2,000",
    "fast": "4,000",
    "fast, twice": "8,000",
}
"""In all, by method of the suite."""


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


def line_table(rows: Sequence[Row]) -> str:
    """Files over lines."""
    heads = ["scene", "line", "kB", "first picture, virtual clock", "first picture, Chromium"]
    heads += ["complete", "against the full model in the first 10 s"]
    lines = list[list[str]]()
    for row in rows:
        browser = f"{row['chromium_first_s']:.1f} s" if row["chromium_first_s"] else "–"
        times = [f"{row['first_picture_s']:.1f} s", browser, f"{row['complete_s']:.1f} s"]
        head = [row["scene"], row["line"], f"{row['bytes'] / 1000:,.0f}"]
        lines.append([*head, *times, f"{row['viewed_10s_db']:.1f} dB"])
    return table_of(heads, lines)


def main() -> None:
    """Gather, measure, write."""
    options = tyro.cli(Options, description=__doc__)
    if options.folders:
        write_rows(ROWS, gathered(options.folders))
        write_rows(LINES, list(lines_of(options.folders[0], "fast")))
    rows, lines = stored_rows(ROWS, TEXT), stored_rows(LINES, TEXT)
    made = made_by(rows)  # before anything is written
    fox = [row for row in rows if row["scene"] == "fox"]
    draw(fox)
    text = "\n\n".join(
        [
            level_table([row for row in rows if row["method"] == "fast"]),
            "### What time buys",
            steps_table(fox),
            "![What minutes of a CPU buy](full_size.svg)",
            "### Over recorded lines",
            line_table(lines),
            f"Seed 0, {made}.",
        ]
    )
    put(PAGE, __file__, text)
    put(README, __file__, short_table([row for row in rows if row["method"] == "fast"]))
    print(PAGE, README, sep="\n")


if __name__ == "__main__":
    main()
