"""What parts of the model and its training are worth; the tables of docs/results/ablations.md.

    OMP_NUM_THREADS=1 python -m benchmarks.train.ablations --jobs 2   # all groups: many hours
    python -m benchmarks.train.ablations --groups control --scenes fox  # some of them
    python -m benchmarks.train.ablations --tables   # only CSV, tables and plots

Every run is one training in runs/ablations, in a process of its own; a finished one is not run
again, and the page shows the groups of `ON_PAGE`, as far as they are of one commit; the CSV has
all. Rows of the CSV whose runs are not here stay, if their options, by whatever names settings had
then, are still those of their group, or if the group is one of an earlier preset. Runs side by side
say nothing about time.
"""

import hashlib
import itertools
import json
import multiprocessing
import re
import statistics
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console

import benchmarks.bench as bench
from benchmarks.bench import DATA, RESULTS, Row, metrics_of, put, stored_rows, write_rows
from benchmarks.train.ablation_groups import GROUPS, PRESET, Group, words_of
from gsynopsis.config.former import new_name
from gsynopsis.config.store import OPTIONS
from gsynopsis.errors import GsynopsisError

RUNS = bench.RUNS / "ablations"
CSV = RESULTS / "ablations.csv"
PAGE = RESULTS / "ablations.md"
ON_PAGE = ("control", "length", "levels")
"""Groups that the page shows."""
TEXT = ("group", "scene", "variant", "options", "commit", "machine")
"""Columns of the CSV that are no numbers."""
LONGEST = 150
"""Characters of a folder's name that say what is in it."""
DERIVED = {"levels.grid_drop"}
"""Settings of earlier versions that follow from others now."""


@dataclass(frozen=True)
class Options:
    """What to run.

    Attributes:
        data: Folder that holds the scenes fox, brighton and bonsai.
        groups: Groups to run; all if empty.
        scenes: Scenes to run; those of each group if empty.
        variants: Variants to run; all if empty.
        seeds: Seeds to run; those of each group if empty.
        jobs: Runs side by side.
        tables: Run nothing, write CSV, tables and plots from the runs there are.
        commit: Whose rows the page shows, as in the CSV; that of most rows if empty.
    """

    data: Path = DATA
    groups: tuple[str, ...] = ()
    scenes: tuple[str, ...] = ()
    variants: tuple[str, ...] = ()
    seeds: tuple[int, ...] = ()
    jobs: int = 1
    tables: bool = False
    commit: str = ""


@dataclass(frozen=True)
class Run:
    """One training: a variant of a group on a scene with a seed."""

    group: Group
    scene: str
    variant: str
    seed: int

    @property
    def folder(self) -> Path:
        """Where it is: by its options, so that groups share what is the same."""
        options = re.sub("[^a-z0-9]+", "-", " ".join(self.options).lower()).strip("-")
        if len(options) > LONGEST:
            digest = hashlib.sha256(options.encode()).hexdigest()[:8]
            options = f"{options[:LONGEST]}-{digest}"
        return RUNS / f"{self.scene}-{self.group.scale:g}-{options}-{self.seed}"

    @property
    def asked(self) -> dict[str, Any]:
        """What it changes of the preset."""
        return {**self.group.common, **self.group.variants[self.variant]}

    @property
    def options(self) -> list[str]:
        """The same on a command line."""
        return words_of(self.asked)

    @cached_property
    def meaning(self) -> dict[str, Any]:
        """The same, to compare."""
        return meaning_of(" ".join(self.options))


def main() -> None:
    options = tyro.cli(Options, description=__doc__)
    if not options.tables:
        runs = [run for run in all_runs() if wanted(run, options)]
        console = Console()
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(options.jobs, context, max_tasks_per_child=1) as pool:
            ends = pool.map(partial(train, options.data), runs)
            for run, end in zip(runs, ends, strict=True):
                console.print(f"{run.folder.name}: {end}")
    stored = stored_rows(CSV, TEXT)
    rows = [row for group in GROUPS for row in rows_of_group(group, stored)]
    write_rows(CSV, rows)
    shown = of_one_commit([row for row in rows if row["group"] in ON_PAGE], options.commit)
    text = [section(group, [r for r in shown if r["group"] == group.name]) for group in GROUPS]
    put(PAGE, __file__, "\n".join([*filter(None, text), made_on(shown)]))
    print(f"wrote {CSV} and {PAGE}")


def of_one_commit(rows: list[Row], commit: str) -> list[Row]:
    """The rows of a commit; of that which has most of them if none is given."""
    wanted = commit or Counter(row["commit"] for row in rows).most_common(1)[0][0]
    return [row for row in rows if row["commit"] == wanted]


def rows_of_group(group: Group, stored: list[Row]) -> list[Row]:
    """Rows of the runs that are here, and of others what the CSV has."""
    if not group.variants:
        return [row for row in stored if row["group"] == group.name]
    rows: list[Row] = []
    for run in (run for run in all_runs() if run.group is group):
        same = {"scene": run.scene, "seed": run.seed, "scale": run.group.scale}
        same |= {"group": group.name}
        old = [
            row | {"variant": run.variant}
            for row in stored
            if same.items() <= row.items() and meaning_of(row["options"]) == run.meaning
        ]
        rows += rows_of(run) or old
    return rows


def all_runs() -> list[Run]:
    """Seeds outermost, so that a stop leaves whole comparisons."""
    return [
        Run(group, scene, variant, seed)
        for seed in sorted({seed for group in GROUPS for seed in group.seeds})
        for group in GROUPS
        if seed in group.seeds
        for scene in group.scenes
        for variant in group.variants
    ]


def wanted(run: Run, options: Options) -> bool:
    """Asked for and not there yet."""
    return (
        run.group.name in (options.groups or {run.group.name})
        and run.scene in (options.scenes or {run.scene})
        and run.variant in (options.variants or {run.variant})
        and run.seed in (options.seeds or {run.seed})
        and not (run.folder / "metrics.json").exists()
    )


def meaning_of(options: str) -> dict[str, Any]:
    """Settings under today's names that the options of a command line give, of any version."""
    short = {option: name for name, option in OPTIONS.items()}
    found: dict[str, Any] = {}
    words = iter(options.split())
    for word in words:
        name, equals, text = word.partition("=")
        if not equals and word != "--set":
            name, text = short[word], next(words)
        elif not equals:
            continue
        new, value = new_name(name, value_of(text))
        found[new] = value
    return {name: value for name, value in found.items() if name not in DERIVED}


def value_of(text: str) -> Any:
    """What `--set` takes a text for."""
    try:
        return json.loads(text)
    except ValueError:
        return text


def train(data: Path, run: Run) -> str:
    """Run it unless another group has; how it ended."""
    if (run.folder / "metrics.json").exists():
        return "done"
    asked = {"scale": run.group.scale, "train.seed": run.seed, **run.asked}
    try:
        bench.train(data / run.scene, run.folder, asked, PRESET)
    except GsynopsisError as error:
        return str(error)
    return "done"


def rows_of(run: Run) -> list[Row]:
    """One row a level of a finished run."""
    metrics = metrics_of(run.folder)
    if not metrics:
        return []
    whole = {
        "group": run.group.name,
        "scene": run.scene,
        "variant": run.variant,
        "seed": run.seed,
        "scale": run.group.scale,
        "options": " ".join(run.options),
        "commit": (metrics.get("commit") or "unknown")[:12],
        "machine": metrics["machine"].get("cpu", "?"),
    }
    return [
        whole
        | {name: level[name] for name in ("level", "anchors", "slots", "bytes_compact")}
        | {name: round(level[name], 4) for name in ("psnr_full", "ssim_full", "psnr_own")}
        for level in metrics["levels"]
    ]


def section(group: Group, rows: list[Row]) -> str:
    """Heading, text, table and plot of a group; nothing where there is nothing to compare."""
    if len(by_variant(group, rows)) < 2:
        return ""
    parts = [f"### {group.title}", group.text, table(group, rows)]
    if group.curves:
        draw_curves(group, rows)
        parts.append(f"![{group.title}](ablations_{group.name}.svg)")
    return "\n\n".join(parts) + "\n"


def table(group: Group, rows: list[Row]) -> str:
    """One row a scene and variant, mean ± spread of the seeds."""
    lines = [
        "| scene | variant | seeds | finest, dB | under it: L2, L1, L0 | "
        "L2, L1, L0 at 1/2, 1/4, 1/8, dB | L0, MiB | "
        "finest, MiB | MiB for the dB of the scene's worst finest | anchors | slots |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for scene in group.scenes:
        variants = by_variant(group, [r for r in rows if r["scene"] == scene])
        curves = {variant: levels_of(own) for variant, own in variants.items()}
        least = min((levels[-1][1] for levels in curves.values()), default=0)
        for variant, own in variants.items():
            top = [r for r in own if r["level"] == max(r["level"] for r in own)]
            levels = curves[variant]
            lines.append(
                f"| {scene} | {variant} | {len(top)} | {spread(top, 'psnr_full')} | "
                f"{coarsest(own)} | "
                f"{levels[-1][0] / 2**20:.3f} | "
                f"{bytes_for(levels, least) / 2**20:.3f} ({least:.2f} dB) | "
                f"{statistics.mean(r['anchors'] for r in top):,.0f} | "
                f"{statistics.mean(r['slots'] for r in top):,.0f} |"
            )
    return "\n".join(lines)


def by_variant(group: Group, rows: list[Row]) -> dict[str, list[Row]]:
    """The rows of each variant that was run, in the order of the group."""
    names = list(group.variants or dict.fromkeys(row["variant"] for row in rows))
    found = {variant: [r for r in rows if r["variant"] == variant] for variant in names}
    return {variant: own for variant, own in found.items() if own}


def levels_of(rows: list[Row], kind: str = "psnr_full") -> list[tuple[float, float]]:
    """Bytes and PSNR of each level of one variant, mean of the seeds, coarsest first."""
    levels = sorted({r["level"] for r in rows})
    seeds = [[r for r in rows if r["level"] == level] for level in levels]
    return [
        (statistics.mean(r["bytes_compact"] for r in s), statistics.mean(r[kind] for r in s))
        for s in seeds
    ]


def bytes_for(levels: list[tuple[float, float]], psnr: float) -> float:
    """Bytes at which a curve reaches a PSNR, between levels on a line over log bytes."""
    for (few, low), (many, high) in itertools.pairwise(levels):
        if low <= psnr <= high:
            return few * (many / few) ** ((psnr - low) / max(high - low, 1e-9))
    return levels[-1][0] if psnr > levels[0][1] else levels[0][0]


def coarsest(rows: list[Row]) -> str:
    """Three cells: levels under the finest, the same at their own size, MiB of level 0."""
    *lower, (_, finest) = levels_of(rows)
    if not lower:
        return "– | – | –"
    under = ", ".join(f"{finest - psnr:.2f}" for _, psnr in reversed(lower))
    own = ", ".join(f"{psnr:.2f}" for _, psnr in levels_of(rows, "psnr_own")[-2::-1])
    return f"{under} | {own} | {lower[0][0] / 2**20:.3f}"


def spread(rows: list[Row], name: str) -> str:
    """Mean, and ± the standard deviation where there is more than one seed."""
    values = [row[name] for row in rows]
    mean = f"{statistics.mean(values):.2f}"
    return f"{mean} ± {statistics.stdev(values):.2f}" if len(values) > 1 else mean


def draw_curves(group: Group, rows: list[Row]) -> None:
    """Rate and distortion of every level, a panel a scene and resolution, mean of the seeds."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    scenes = [s for s in group.scenes if any(r["scene"] == s for r in rows)]
    kinds = {"psnr_full": "PSNR, dB", "psnr_own": "PSNR at 1/8, 1/4, 1/2, 1, dB"}
    variants = by_variant(group, rows)
    with mpl.rc_context({"svg.hashsalt": group.name, "svg.fonttype": "none"}):
        figure = Figure(figsize=(3.6 * len(scenes), 6.4), layout="constrained")
        panels = figure.subplots(2, len(scenes), squeeze=False)
        for axes, (kind, scene) in zip(panels.flat, itertools.product(kinds, scenes), strict=True):
            for variant, own in variants.items():
                levels = levels_of([r for r in own if r["scene"] == scene], kind)
                sizes, values = [b / 2**20 for b, _ in levels], [psnr for _, psnr in levels]
                axes.plot(sizes, values, "o-", label=variant)
            axes.set(title=scene, xlabel="MiB up to the level's end", ylabel=kinds[kind])
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4)
        figure.savefig(RESULTS / f"ablations_{group.name}.svg", metadata={"Date": None})


def made_on(rows: list[Row]) -> str:
    """Machine and commit of the runs that are shown."""
    machines = ", ".join(sorted({row["machine"] for row in rows}))
    return f"Made on {machines}; commit {rows[0]['commit']}. Seeds and options are in the CSV."


if __name__ == "__main__":
    main()
