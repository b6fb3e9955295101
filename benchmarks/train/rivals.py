"""Other methods beside ours: docs/results/rivals.md from a finished suite.

    gsynopsis bench suites/rivals.toml --out RIVALS
    python -m benchmarks.train.rivals RIVALS

Copies the suite's rows into docs/results/rivals.csv and draws their curves. Without a folder the
page is written anew from the CSV.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from tyro.conf import Positional

from benchmarks.bench import RESULTS, Row, put, stored_rows, write_rows
from gsynopsis.bench.table import KINDS, curve_of, rate_text, rates_of, spread
from gsynopsis.evaluation.bdrate import Points, frontier

PAGE, ROWS, CURVES = (RESULTS / f"rivals.{kind}" for kind in ("md", "csv", "svg"))
TEXT = ("scene", "method", "split", "version", "commit", "machine")
OURS = "ours"
NAMES = {
    "ours": "ours (`fast`)",
    "scaffold": "Scaffold-GS in joint levels",
    "gaussians": "3DGS, one level",
    "contribution": "3DGS in PRoGS's order",
    "decimate": "3DGS by opacity and area",
    "gode": "GoDe",
    "prefix": "Matryoshka, any prefix",
    "layers": "L3GS, layers",
    "lapis": "LapisGS",
    "octree": "Octree-GS",
}
SAMPLES = 257
MIB = 2**20


@dataclass(frozen=True)
class Options:
    """What to write.

    Attributes:
        folder: Of a finished suite; none: the page alone.
    """

    folder: Positional[Path | None] = None


def worst_ratio(ours: Points, other: Points) -> float | None:
    """The most bytes that ours needs over those of another, of all qualities that both reach.

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


def line_of(rows: Sequence[Row], method: str) -> list[str]:
    """One method of a scene: its levels, then bytes of ours against it."""
    own = [row for row in rows if row["method"] == method]
    seeds = sorted({row["seed"] for row in own})
    cells = list[str]()
    for level in sorted({row["level"] for row in own}):
        same = [row for row in own if row["level"] == level]
        size = sum(row["bytes_compact"] for row in same) / len(same) / MIB
        cells.append(f"{spread([row['psnr_full'] for row in same])} in {size:.3f}")
    cells = ["–"] * (4 - len(cells)) + cells
    if method == OURS:
        rates, worst = ["", ""], ""
    else:
        rates = [rate_text(rates_of(rows, OURS, method, kind)) for kind in KINDS]
        found = [
            worst_ratio(curve_of(rows, OURS, seed, "full"), curve_of(rows, method, seed, "full"))
            for seed in seeds
        ]
        known = [ratio for ratio in found if ratio is not None]
        worst = f"{max(known):.2f}" if known else "n/a"
    minutes = sum(r["cpu_seconds"] for r in own if not r["level"]) / len(seeds) / 60
    return [NAMES.get(method, method), *cells, *rates, worst, f"{minutes:.0f}"]


def table(rows: Sequence[Row]) -> str:
    """Methods of one scene."""
    heads = ["method", "L0, dB in MiB", "L1", "L2", "L3"]
    heads += ["bytes of ours at equal dB", "the same, own sizes", "worst ratio", "CPU min"]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    methods = dict.fromkeys(row["method"] for row in rows)
    return "\n".join([*lines, *("| " + " | ".join(line_of(rows, m)) + " |" for m in methods)])


def draw(rows: Sequence[Row]) -> None:
    """A panel a scene: quality over bytes."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    with mpl.rc_context({"svg.hashsalt": "rivals", "svg.fonttype": "none"}):
        figure = Figure(figsize=(7.2, 4.2 * len(scenes)), layout="constrained")
        panels = figure.subplots(len(scenes), 1, squeeze=False)
        for axes, scene in zip(panels.flat, scenes, strict=True):
            of_scene = [row for row in rows if row["scene"] == scene]
            for method in dict.fromkeys(row["method"] for row in of_scene):
                seed = min(row["seed"] for row in of_scene if row["method"] == method)
                points = curve_of(of_scene, method, seed, "full")
                sizes, values = [size / MIB for size, _ in points], [psnr for _, psnr in points]
                width = 2.5 if method == OURS else 1.2
                axes.plot(sizes, values, "o-", label=NAMES.get(method, method), linewidth=width)
            axes.set(
                title=scene, xscale="log", xlabel="MiB up to the level's end", ylabel="PSNR, dB"
            )
        panels[0, 0].legend(fontsize=8)
        figure.savefig(CURVES, metadata={"Date": None})


def main() -> None:
    """Gather, draw, write."""
    options = tyro.cli(Options, description=__doc__)
    if options.folder is not None:
        write_rows(ROWS, stored_rows(options.folder / "results.csv", TEXT))
    rows = stored_rows(ROWS, TEXT)
    commits, machines = ({row[name] for row in rows} for name in ("commit", "machine"))
    if len(commits) != 1:
        sys.exit(f"rows are of several commits: {', '.join(sorted(commits))}")
    draw(rows)
    parts = list[str]()
    for scene in dict.fromkeys(row["scene"] for row in rows):
        own = [row for row in rows if row["scene"] == scene]
        about = (
            f"{own[0]['width']} × {own[0]['height']} pixels, {own[0]['test_photos']} test photos"
        )
        parts += [f"### {scene}", f"{about}, {own[0]['split']}.", table(own)]
    seeds = ", ".join(str(seed) for seed in sorted({row["seed"] for row in rows}))
    parts += [
        "![Quality over bytes](rivals.svg)",
        f"Seeds {seeds}; {', '.join(sorted(machines))}, commit {commits.pop()}.",
    ]
    put(PAGE, __file__, "\n\n".join(parts))
    print(PAGE, CURVES, sep="\n")


if __name__ == "__main__":
    main()
