"""Other methods beside ours: docs/results/quality.md from finished suites.

    python -m research suites/strongest.toml --data DATA --out STRONGEST
    python -m research suites/strongest_full_size.toml --data DATA --out FULL
    python -m benchmarks.train.rivals STRONGEST FULL
    python -m benchmarks.train.rivals --at-size LATER

Levels of ours and of each rival on each scene, dB in MiB, what ours needs beside it, and a
drawing. Rows go into docs/results/rivals.csv; without a folder the page is written again from
these. suites/rivals.toml has all other methods and takes a day.

Scenes at size of a later commit: rivals_at_size.csv, a part of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean

import numpy as np
import tyro
from tyro.conf import Positional

from benchmarks.bench import RESULTS, Row, figure_at, put, stored_rows, table_of, write_rows
from benchmarks.train.cells import (
    MIB,
    by_scene,
    finished_cells,
    level_cell,
    levels_text,
    made_by,
    scene_head,
)
from research.suites.bdrate import (
    BdRate,
    Points,
    bd_psnr,
    bd_rate,
    frontier,
    is_wide,
    shared_range,
)
from research.suites.table import Curve, curve_of, spread_of

PAGE = RESULTS / "quality.md"
ROWS, CURVES = (RESULTS / f"rivals.{kind}" for kind in ("csv", "svg"))
AT_SIZE = RESULTS / "rivals_at_size.csv"
TEXT = ("scene", "method", "split", "version", "commit", "machine")
OURS = "ours"
NAMES = {
    OURS: "ours (`standard`)",
    "plain": "plain features, our training",
    "gaussians": "3DGS, one level",
    "contribution": "3DGS by blend weight (PRoGS)",
    "decimate": "3DGS by opacity and area",
    "gode": "3DGS by colour gradients, tuned (GoDe)",
    "prefix": "3DGS, random prefixes (Matryoshka)",
    "layers": "3DGS in bands (L3GS)",
    "lapis": "layers by photo size (LapisGS)",
    "mcmc": "3DGS-MCMC, pruned, tuned as GoDe",
    "mcmc, degree 0": "3DGS-MCMC without harmonics",
    "octree": "lattices by distance (Octree-GS)",
}
FINEST, SAMPLES = 3, 257
BEYOND = 0.1
"""Decibels above our finest level from which the page says that a rival goes on."""


@dataclass(frozen=True)
class Options:
    """Options of the page.

    Attributes:
        folders: Folders of suites, scenes of one name in one of them; none: the page alone.
        at_size: The same of scenes at size that were made later.
    """

    folders: Positional[tuple[Path, ...]] = ()
    at_size: tuple[Path, ...] = ()


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


def by_method(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Rows of each method that there is, methods in the order of their names."""
    every = {name: [row for row in rows if row["method"] == name] for name in NAMES}
    return {name: some for name, some in every.items() if some}


def summary(rows: Sequence[Row]) -> str:
    """Levels of ours and of each rival on each scene, and bytes of ours against it."""
    lines, numbers = list[list[str]](), range(FINEST + 1)
    for scene, own in by_scene(rows).items():
        for name, some in by_method(own).items():
            ends = [r["psnr_uncoded"] for r in some if r["level"] == FINEST and r["psnr_uncoded"]]
            before = f"{mean(ends):.2f}" if ends else ""
            levels = [level_cell([r for r in some if r["level"] == k]) for k in numbers]
            rate = "" if name == OURS else short_rate(own, name)
            lines.append([scene if name == OURS else "", NAMES[name], *levels, before, rate])
    heads = [*(f"L{k}" for k in numbers), "before rounding", "bytes of ours"]
    return table_of(["scene", "method", *heads], lines)


def sentences(rows: Sequence[Row]) -> str:
    """Scenes that were made later, as a list: levels of each method, bytes of ours against it."""
    lines = list[str]()
    for own in by_scene(rows).values():
        each = list[str]()
        for name, some in by_method(own).items():
            rate = "" if name == OURS else f" (bytes of ours: {short_rate(own, name)})"
            each.append(f"{NAMES[name]} {levels_text(some)} MiB{rate}")
        lines.append(f"* {scene_head(own)}: {'; '.join(each)}.")
    return "\n".join(lines)


def origin_of(rows: Sequence[Row]) -> str:
    """Seeds, machine and commit of rows, a sentence."""
    seeds = ", ".join(str(seed) for seed in sorted({row["seed"] for row in rows}))
    return f"Seeds: {seeds}; {made_by(rows)}."


def gather(folders: Sequence[Path], rows: Path) -> None:
    """Copy the rows of finished cells."""
    cells = [own for folder in folders for _, own in finished_cells(folder)]
    write_rows(rows, [row for own in cells for row in own])


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
        for axes in panels.flat[len(scenes) :]:
            axes.set_axis_off()


def main() -> None:
    """Gather, draw, write."""
    options = tyro.cli(Options, description=__doc__)
    if options.folders:
        gather(options.folders, ROWS)
    if options.at_size:
        gather(options.at_size, AT_SIZE)
    rows, later = stored_rows(ROWS, TEXT), stored_rows(AT_SIZE, TEXT)
    origins = [origin_of(some) for some in (rows, later)]  # before anything is written
    draw(rows)
    photos = "; ".join(scene_head(own) for own in by_scene(rows).values())
    where = f"![Quality over bytes](rivals.svg)\n\n{photos}. {origins[0]}"
    put(PAGE, __file__, f"{summary(rows)}\n\n{where}")
    put(PAGE, __file__, f"{sentences(later)}\n\n{origins[1]}", "at size")
    print(PAGE, CURVES, sep="\n")


if __name__ == "__main__":
    main()
