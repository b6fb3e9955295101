"""Other methods beside ours: docs/results/quality.md from a finished suite.

    python -m research suites/rivals.toml --data DATA --seeds 0 --out RIVALS
    python -m benchmarks.train.rivals RIVALS
    python -m research suites/ours.toml --data DATA --out OURS
    python -m benchmarks.train.rivals --ours OURS
    python -m research suites/strongest.toml --data DATA --out STRONGEST
    python -m research suites/strongest_full_size.toml --data DATA --out FULL
    python -m benchmarks.train.rivals --strongest STRONGEST FULL

Copies the rows of scenes for which all but ours are done into docs/results/rivals.csv, in place of
older ones of these scenes, and draws their curves; measures what 3DGS and plain features have on
the photos that they were trained on, too, into rivals_seen.csv. Ours has more seeds, and is of a
later commit: rivals_ours.csv. Plain features on the photos held out are those of quality.csv. The
strongest rivals and ours, of one commit, are a list of their own and rivals_strongest.csv.
Without a folder the page is written again from the CSVs.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean

import numpy as np
import torch
import tyro
from tyro.conf import Positional

from benchmarks.bench import (
    DATA,
    RESULTS,
    ROOT,
    Row,
    figure_at,
    put,
    stored_rows,
    table_of,
    write_rows,
)
from benchmarks.train.cells import (
    MIB,
    by_scene,
    finished_cells,
    levels_text,
    made_by,
    scene_head,
)
from gsynopsis.evaluation.load_model import open_levels
from gsynopsis.evaluation.metrics import psnr
from gsynopsis.evaluation.protocols import LevelRenderer
from gsynopsis.scene.load import load_scene
from research.suites.bdrate import (
    BdRate,
    Points,
    bd_psnr,
    bd_rate,
    frontier,
    is_wide,
    shared_range,
)
from research.suites.experiment import scale_of, scene_folder
from research.suites.suite import Cell, read_suite
from research.suites.table import Curve, curve_of, spread_of

PAGE = RESULTS / "quality.md"
ROWS, CURVES = (RESULTS / f"rivals.{kind}" for kind in ("csv", "svg"))
SEEN, OUR_ROWS = RESULTS / "rivals_seen.csv", RESULTS / "rivals_ours.csv"
STRONGEST = RESULTS / "rivals_strongest.csv"
SUITE = ROOT / "suites" / "rivals.toml"
TEXT = ("scene", "method", "split", "version", "commit", "machine")
OURS = "ours"
QUALITY = RESULTS / "quality.csv"
FROM_QUALITY = "plain, as published"
"""The method whose rows quality.csv has; it is `plain` in the suite of rivals."""
PLAIN = "plain"
RIVALS = {
    "gaussians": "3DGS, one level",
    "contribution": "3DGS by blend weight (PRoGS)",
    "decimate": "3DGS by opacity and area",
    "gode": "3DGS by colour gradients, tuned (GoDe)",
    "prefix": "3DGS, random prefixes (Matryoshka)",
    "layers": "3DGS in bands (L3GS)",
    "lapis": "layers by photo size (LapisGS)",
    "mcmc": "3DGS-MCMC, pruned, tuned as GoDe",
    "octree": "lattices by distance (Octree-GS)",
}
NAMES = {
    OURS: "ours (`fast`)",
    PLAIN: "plain features, our training",
    **RIVALS,
    "mcmc, degree 0": "the same, of degree 0",
}
SOUND = (PLAIN, "gaussians")
"""Methods that are measured on the photos they were trained on, too."""
SAMPLES = 257
BEYOND = 0.1
"""Decibels above our finest level from which the table says that a rival goes on."""


@dataclass(frozen=True)
class Options:
    """Options of the page.

    Attributes:
        folder: Folder of the suite; none: the page alone.
        ours: Folder of the suite of ours alone, all of it; none: the rows of its CSV.
        strongest: Folders of the suites of the strongest rivals; likewise.
        procedural: Folder of the procedural scenes, as `--scenes` of the suite.
    """

    folder: Positional[Path | None] = None
    ours: Path | None = None
    strongest: tuple[Path, ...] = ()
    procedural: Path = Path("runs/procedural")


def worst_ratio(ours: Points, other: Points) -> float | None:
    """The most bytes of ours over those of another method, of all qualities that both reach.

    Below 1 where ours is ahead everywhere. Log bytes are interpolated linearly over PSNR.

    Args:
        ours: Bytes and PSNR of each level.
        other: The same; one point is a curve too.

    Returns:
        None if there is no quality that both reach.
    """
    curves = [frontier(points) for points in (ours, other)]
    low, high = max(c[0, 1] for c in curves), min(c[-1, 1] for c in curves)
    if high < low:
        return None
    at = np.linspace(low, high, SAMPLES)
    mine, theirs = (np.interp(at, c[:, 1], np.log(c[:, 0])) for c in curves)
    return float(np.exp(np.max(mine - theirs)))


def finished(folder: Path) -> Iterator[tuple[Cell, Path, list[Row]]]:
    """Cells of the scenes and seeds for which all are done, their folders and rows; not ours."""
    done = {
        (rows[0]["scene"], rows[0]["method"], rows[0]["seed"]): (place, rows)
        for place, rows in finished_cells(folder)
    }
    cells = [cell for cell in read_suite(SUITE, DATA).cells if cell.method in (*RIVALS, *SOUND)]
    named = {(cell.scene, cell.method, cell.seed): cell for cell in cells}
    missing = {(scene, seed) for scene, method, seed in named if (scene, method, seed) not in done}
    for key, cell in named.items():
        if (cell.scene, cell.seed) not in missing:
            yield cell, *done[key]


def seen_row(cell: Cell, folder: Path, rows: Sequence[Row], procedural: Path) -> Row:
    """The finest level of a cell on the photos held out and on those it was trained on."""
    scene = load_scene(scene_folder(cell, procedural), cell.asked["split"])
    opened, scale = open_levels(folder / "scene.gsyn", "cpu"), scale_of(cell, scene)
    painter = LevelRenderer(opened.decoder, opened.renderer, torch.zeros(3))
    finest = len(opened.levels.levels) - 1
    with torch.no_grad():
        values = [
            psnr(painter.paint(scene.camera(view, scale), finest), scene.image(view, scale))
            for view in scene.train
        ]
    return {
        **{name: rows[-1][name] for name in ("scene", "method", "seed", "test_photos")},
        "psnr_test": rows[-1]["psnr_full"],
        "train_photos": len(scene.train),
        "psnr_train": round(mean(values), 4),
        "commit": rows[-1]["commit"],
    }


def pairs(rows: Sequence[Row], method: str) -> list[tuple[Curve, Curve]]:
    """Curves of ours, of each seed, and of a rival: of the same seed, else of its first."""
    seeds = {
        name: sorted({r["seed"] for r in rows if r["method"] == name}) for name in (OURS, method)
    }
    theirs = [seed if seed in seeds[method] else seeds[method][0] for seed in seeds[OURS]]
    return [
        (curve_of(rows, OURS, mine, "full"), curve_of(rows, method, other, "full"))
        for mine, other in zip(seeds[OURS], theirs, strict=True)
    ]


def rates_of_pairs(both: Sequence[tuple[Curve, Curve]]) -> list[BdRate]:
    """BD-rates of ours against a rival, of each pair that has one."""
    found = (bd_rate(theirs, ours) for ours, theirs in both)
    return [rate for rate in found if rate is not None]


def short_rate(rows: Sequence[Row], method: str) -> str:
    """BD-rate and worst ratio of ours against a rival; BD-PSNR and how far, where it goes on above.

    Or that no quality is reached by both, or that too little is for a rate. Of how many seeds,
    where not all of ours have a quality that both reach.
    """
    both = pairs(rows, method)
    worst = [ratio for one in both if (ratio := worst_ratio(*one)) is not None]
    ends = [mean(max(psnr for _, psnr in one[side]) for one in both) for side in (0, 1)]
    beyond = f", up to {ends[1] - ends[0]:+.1f} dB" if ends[1] - ends[0] >= BEYOND else ""
    if not worst:
        lowest = min(psnr for ours, _ in both for _, psnr in ours)
        below = max(psnr for _, other in both for _, psnr in other) < lowest
        return "below" if below else f"above{beyond}"
    rates = rates_of_pairs(both)
    spread = max(spread_of(rows, name, "full") for name in (OURS, method))
    if is_wide(rates, spread):
        more = [found for ours, theirs in both if (found := bd_psnr(theirs, ours)) is not None]
        beside = f" ({mean(more):+.1f} dB)" if more and beyond else ""
        told = f"{mean(rate.percent for rate in rates):+.0f} %{beside}"
    elif rates:
        low, high = shared_range(rates)
        told = f"n/a, {max(0.0, high - low):.1f} dB shared"
    else:
        told = "–"
    some = "" if len(worst) == len(both) else f" ({len(worst)} of {len(both)} seeds)"
    return f"{told}, {max(worst):.2f}{beyond}{some}"


def summary(rows: Sequence[Row]) -> str:
    """Bytes of ours against each rival on each scene."""
    parts = by_scene(rows)
    lines = [
        [name, *(short_rate(own, method) for own in parts.values())]
        for method, name in NAMES.items()
        if method != OURS and any(row["method"] == method for row in rows)
    ]
    return table_of(["against", *parts], lines)


def strongest_lines(rows: Sequence[Row]) -> str:
    """A line for each scene: levels of ours and of each rival, and bytes of ours against it."""
    lines: list[str] = []
    for own in by_scene(rows).values():
        of = {name: [row for row in own if row["method"] == name] for name in NAMES}
        told = [
            f"{NAMES[name]} {levels_text(some)}"
            + (f" ({short_rate(own, name)})" if name != OURS else "")
            for name, some in of.items()
            if some
        ]
        lines.append(f"* {scene_head(own)}: {'; '.join(told)}.")
    return "\n".join(lines)


def draw(rows: Sequence[Row]) -> None:
    """A panel a scene: quality over bytes."""
    scenes = by_scene(rows)
    with figure_at(CURVES, 11, 3.4 * -(-len(scenes) // 2)) as figure:
        panels = figure.subplots(-(-len(scenes) // 2), 2, squeeze=False)
        for axes, (scene, of_scene) in zip(panels.flat, scenes.items(), strict=False):
            for method in dict.fromkeys(row["method"] for row in of_scene):
                seed = min(row["seed"] for row in of_scene if row["method"] == method)
                points = curve_of(of_scene, method, seed, "full")
                sizes, values = [size / MIB for size, _ in points], [psnr for _, psnr in points]
                width = 2.5 if method == OURS else 1.2
                axes.plot(sizes, values, "o-", label=NAMES.get(method, method), linewidth=width)
            axes.set(
                title=scene, xscale="log", xlabel="MiB up to the level's end", ylabel="PSNR, dB"
            )
        panels[0, 0].legend(fontsize=6)


def gather(folder: Path, procedural: Path) -> None:
    """Write a suite's rows into the CSVs, in place of those of the same scenes."""
    cells = list(finished(folder))
    replace(ROWS, [row for cell, _, own in cells if cell.method in RIVALS for row in own])
    replace(SEEN, [seen_row(*one, procedural) for one in cells if one[0].method in SOUND])


def replace(path: Path, rows: Sequence[Row]) -> None:
    """Put rows into a CSV in place of those of the same scenes; scenes in the suite's order."""
    new = {row["scene"] for row in rows}
    every = [*(row for row in stored_rows(path, TEXT) if row["scene"] not in new), *rows]
    scenes = list(dict.fromkeys(cell.scene for cell in read_suite(SUITE, DATA).cells))
    every.sort(key=lambda row: scenes.index(row["scene"]))
    write_rows(path, every)


def with_ours(rows: Sequence[Row], ours: Sequence[Row]) -> list[Row]:
    """Rows of rivals, and before those of each scene ours and plain features."""
    plain = [row for row in stored_rows(QUALITY, TEXT) if row["method"] == FROM_QUALITY]
    plain = [{**row, "method": PLAIN} for row in plain]
    scenes = dict.fromkeys(row["scene"] for row in rows)
    return [row for scene in scenes for row in (*ours, *plain, *rows) if row["scene"] == scene]


def main() -> None:
    """Gather, draw, write."""
    options = tyro.cli(Options, description=__doc__)
    if options.folder is not None:
        gather(options.folder, options.procedural)
    if options.ours is not None:
        write_rows(OUR_ROWS, [row for _, own in finished_cells(options.ours) for row in own])
    if options.strongest:
        cells = [cell for folder in options.strongest for cell in finished_cells(folder)]
        write_rows(STRONGEST, [row for _, own in cells for row in own])
    rivals, seen, ours = (stored_rows(path, TEXT) for path in (ROWS, SEEN, OUR_ROWS))
    made = made_by([*rivals, *seen])  # before anything is written
    made_by(ours)
    rows = with_ours(rivals, ours)
    draw(rows)
    seeds, own = (
        ", ".join(str(seed) for seed in sorted({row["seed"] for row in some}))
        for some in (rivals, ours)
    )
    parts = [
        summary(rows),
        "![Quality over bytes](rivals.svg)",
        f"Rivals: seed {seeds}; {made}. Ours: seeds {own}, [rivals_ours.csv](rivals_ours.csv); "
        "plain features: all seeds of [quality.csv](quality.csv).",
    ]
    put(PAGE, __file__, "\n\n".join(parts))
    strongest = stored_rows(STRONGEST, TEXT)
    where = f"Seed 0, {made_by(strongest)}."
    put(PAGE, __file__, f"{strongest_lines(strongest)}\n\n{where}", "strongest")
    print(PAGE, CURVES, sep="\n")


if __name__ == "__main__":
    main()
