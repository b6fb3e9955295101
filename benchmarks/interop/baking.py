"""Cost of baking: every level of fox and bonsai as plain Gaussians (docs/results/interop.md).

    python -m benchmarks.interop.baking
    python -m benchmarks.interop.baking --runs runs/scenes --only fox-fast

Rows of runs that are not baked again stay as docs/results/baking.csv has them.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import tyro

import benchmarks.bench as bench
from benchmarks.bench import RESULTS, Row, put, stored_rows, table_of, write_rows
from gsynopsis.evaluation.formatting import size
from gsynopsis.evaluation.load_model import open_levels
from gsynopsis.jobs.export import (
    STEPS_DEFAULT,
    Baked,
    Exporting,
    Photographed,
    bake_level,
    encoded,
)
from gsynopsis.runs.folder import find_run, scene_of
from gsynopsis.scene.load import load_scene

CSV = RESULTS / "baking.csv"
PAGE = RESULTS / "interop.md"
FORMATS = ("ply", "compressed-ply", "spz", "spz3", "sog", "glb", "usd")
SHOWN = ("ply", "sog")
"""Formats whose sizes the page has."""
MEASURED = ("anchors", "baked", "tuned")
TEXT = ("run", "machine", "commit")


@dataclass(frozen=True)
class Options:
    """Runs to bake.

    Attributes:
        runs: Folder that holds the runs fox-fast and bonsai-fast.
        only: Names of runs; both if empty.
    """

    runs: Path = bench.RUNS / "scenes"
    only: tuple[str, ...] = ()


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    rows = stored_rows(CSV, TEXT) if CSV.exists() else []
    for name in options.only or ("fox-fast", "bonsai-fast"):
        rows = [row for row in rows if row["run"] != name]
        for row in rows_of(name, options.runs / name):
            rows.append(row)
            write_rows(CSV, rows)
            put(PAGE, __file__, table(rows))


def rows_of(name: str, folder: Path) -> Iterator[Row]:
    """A row for each level of a run."""
    run = find_run(folder)
    scene, scale, split = scene_of(run, None, None, None)
    photos = Photographed(load_scene(scene, split), scale)
    opened = open_levels(run.file)
    exporting = Exporting(steps=STEPS_DEFAULT)
    camera = photos.scene.camera(photos.scene.test[0], scale)
    facts = {
        "width": camera.width,
        "height": camera.height,
        "photos": len(photos.scene.test),
        "machine": bench.machine().cpu,
        "commit": (bench.this_build().commit or "unknown")[:12],
    }
    for level in reversed(range(len(opened.levels.levels))):
        baked = bake_level(opened, level, exporting, photos)
        print(name, level, baked.stages, flush=True)
        yield {"run": name, "level": level, **row_of(baked), **facts}


def row_of(baked: Baked) -> Row:
    """Decibels of the stages and bytes of the formats."""
    stages = baked.stages
    assert stages is not None
    row: Row = {"gaussians": len(baked.gaussians)}
    row |= {stage: round(getattr(stages, stage), 4) for stage in MEASURED}
    return row | {name: len(encoded(baked.gaussians, name, False)) for name in FORMATS}


def table(rows: list[Row]) -> str:
    """Markdown: a row for each level; other formats are in the CSV."""
    heads = ["run", "level", "Gaussians", "level, dB", "baked", "fine-tuned", "cost", *SHOWN]
    lines = list[list[str]]()
    for row in sorted(rows, key=lambda r: (r["run"], r["level"])):
        cost = row["anchors"] - row["tuned"]
        cells = [row["run"], f"L{row['level']}", f"{row['gaussians']:,}"]
        cells += [f"{row[stage]:.2f}" for stage in MEASURED]
        cells += [f"{cost:+.2f}", *(size(int(row[name])) for name in SHOWN)]
        lines.append(cells)
    sizes = {r["run"]: f"{r['photos']} photos of {r['width']} × {r['height']}" for r in rows}
    held = ", ".join(f"{run} {text}" for run, text in sorted(sizes.items()))
    made = "; ".join(sorted({f"{r['machine']}, commit {r['commit']}" for r in rows}))
    return f"{table_of(heads, lines)}\n\nHeld out: {held}. Seed 0, {made}."


if __name__ == "__main__":
    main()
