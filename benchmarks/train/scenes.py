"""Real scenes, trained and evaluated, as CSV (docs/results/scenes.csv) and a line (quality.md).

    python -m benchmarks.train.scenes             # all of them
    python -m benchmarks.train.scenes --only fox-fast fox-free
    python -m benchmarks.train.scenes --tables    # only write CSV and page again

Each experiment is one training; a finished one is not run again, and one whose run is not
here keeps its rows of the CSV. Nothing else should run on the machine meanwhile: times are wall
time.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

import benchmarks.bench as bench
from benchmarks.bench import DATA, RESULTS, Row, metrics_of, put, stored_rows, write_rows

RUNS = bench.RUNS / "scenes"
CSV = RESULTS / "scenes.csv"
Asked = Mapping[str, Any]
"""Settings by dotted name."""
CONTROL: Asked = {
    "model.feature": "free",
    "levels.prune_share": 0,
    "train.growth.threshold": 0.0002,
    "train.growth.cell": 16,
    "model.slots": 10,
    "levels.weights": "separate",
}
"""Plain features as in Scaffold-GS."""
SEQUENTIAL: Asked = {"levels.mode": "sequential", "levels.steps": 833, "train.steps": 1500}
"""As many steps as joint: 1,500 and three times 833."""
PAGE = RESULTS / "quality.md"
EXPERIMENTS: dict[str, tuple[str, str, Asked]] = {
    "fox-fast": ("fox", "standard", {}),
    "fox-free": ("fox", "standard", CONTROL),
    "fox-sequential": ("fox", "standard", SEQUENTIAL),
    "fox-paper": ("fox", "paper", {"train.steps": 2000}),
    "brighton-fast": ("brighton", "standard", {}),
    "bonsai-fast": ("bonsai", "standard", {}),
}
"""Scene, preset and settings beside a scale of 4; each takes 4,000 steps in all."""
COLUMNS: tuple[str, ...] = (
    "experiment",
    "scene",
    "scale",
    "preset",
    "seed",
    "steps",
    "train_seconds",
    "anchors",
    "level",
    "level_anchors",
    "slots",
    "psnr_full",
    "width_full",
    "height_full",
    "psnr_photo",
    "width_photo",
    "height_photo",
    "ssim_full",
    "psnr_own",
    "ssim_own",
    "bytes_paper",
    "bytes_deflate",
    "bytes_raw",
    "bytes_compact",
    "delta_compact",
    "render_ms",
    "machine",
    "commit",
)
TEXT = ("experiment", "scene", "preset", "machine", "commit")
"""Columns that are no numbers."""


@dataclass(frozen=True)
class Options:
    """Options of the trainings.

    Attributes:
        data: Folder that holds the scenes fox, brighton and bonsai.
        only: Experiments to run; all if empty.
        tables: Run nothing, write CSV and page from the runs there are.
    """

    data: Path = DATA
    only: tuple[str, ...] = ()
    tables: bool = False


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    for name, (scene, preset, asked) in EXPERIMENTS.items():
        wanted = not options.tables and name in (options.only or EXPERIMENTS)
        if not wanted or (RUNS / name / "metrics.json").exists():
            continue
        print(name, flush=True)
        bench.train(options.data / scene, RUNS / name, {"scale": 4, **asked}, preset)
    stored = stored_rows(CSV, TEXT)
    rows = [row for name in EXPERIMENTS for row in rows_of(name) or of_experiment(name, stored)]
    write_rows(CSV, rows, COLUMNS)
    put(PAGE, __file__, text_of([r for r in rows if r["experiment"].endswith("-fast")]))
    print(f"wrote {CSV} and {PAGE}")


def of_experiment(name: str, rows: list[Row]) -> list[Row]:
    """Those of one experiment."""
    return [row for row in rows if row["experiment"] == name]


def rows_of(name: str) -> list[Row]:
    """One row a level of a finished experiment."""
    metrics = metrics_of(RUNS / name)
    if not metrics:
        return []
    run = {k: metrics[k] for k in COLUMNS if k in metrics and k not in ("machine", "commit")}
    rows = []
    for level in metrics["levels"]:
        own = {k: level[k] for k in COLUMNS if k in level and k not in ("anchors", "level")}
        row = {"experiment": name, **run, "level": level["level"], **own}
        row |= {"level_anchors": level["anchors"], "machine": machine(metrics)}
        row |= {"commit": (metrics.get("commit") or "unknown")[:12]}
        rows.append({k: round(v, 4) if isinstance(v, float) else v for k, v in row.items()})
    return rows


def text_of(rows: list[Row]) -> str:
    """Size and quality of the finest level at the run's pictures and at the photos' own."""
    finest = [row for row in rows if row["level"] == 3]
    parts = [
        f"{row['scene']} {picture(row, 'full')}: {row['psnr_full']:.2f} dB in "
        f"{row['bytes_compact'] / 2**20:.2f} MiB, and {row['psnr_photo']:.2f} dB seen at "
        f"{picture(row, 'photo')}"
        for row in finest
    ]
    made = {(str(row["machine"]).partition(", torch")[0], row["commit"]) for row in finest}
    where = "; ".join(f"{cpu}, commit {commit}" for cpu, commit in sorted(made))
    return f"{'; '.join(parts)}. Seed {finest[0]['seed']}, {where}."


def picture(row: Row, kind: str) -> str:
    """The size of the pictures of a figure, pixels."""
    return f"{row[f'width_{kind}']} × {row[f'height_{kind}']}"


def machine(metrics: dict[str, Any]) -> str:
    """Processor and number of cores, short."""
    facts = metrics["machine"]
    return f"{facts.get('cpu', '?')}, {facts.get('cores', '?')} cores, torch {facts.get('torch')}"


if __name__ == "__main__":
    main()
