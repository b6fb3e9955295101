"""Our model beside plain features and the paper's: docs/results/quality.md.

    python -m research suites/quality.toml --out QUALITY
    python -m benchmarks.train.quality --suite QUALITY

Copies the rows of finished cells, of an unfinished suite too, into docs/results/quality.csv. For
ours and plain features only seeds count that are finished for all three methods of a scene; for the
paper's preset all finished ones. Without a folder the page is written again from the CSV.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean

import tyro

from benchmarks.bench import RESULTS, Row, put, stored_rows, table_of, write_rows
from benchmarks.train.cells import finished_cells, level_cell, made_by, own_cell, scene_head
from research.suites.table import rate_text, rates_of

PAGE, ROWS = (RESULTS / f"quality.{kind}" for kind in ("md", "csv"))
TEXT = ("scene", "method", "split", "version", "commit", "machine")
OURS = "ours"
PLAIN = ("plain, all parts", "plain, as published")
PAPER = "paper"
METHODS = (OURS, *PLAIN, PAPER)
SCENES = ("fox", "brighton", "bonsai", "indoor", "outdoor", "object")
BAR = -20.0
"""Per cent of bytes that ours should need less than the best of plain features."""
OWN_BYTES = 0.6
"""Share of the bytes of sequential levels that joint ones should need at their own sizes."""


@dataclass(frozen=True)
class Options:
    """Options of the page.

    Attributes:
        suite: Folder of the suite; none: the rows that are there.
    """

    suite: Path | None = None


def gathered(suite: Path) -> list[Row]:
    """Rows of all finished cells."""
    rows = [row for _, own in finished_cells(suite) for row in own]
    return sorted(
        rows, key=lambda r: (SCENES.index(r["scene"]), METHODS.index(r["method"]), r["seed"])
    )


def of_scene(rows: Sequence[Row], scene: str) -> list[Row]:
    """Those of seeds that ours and both plain methods have."""
    own = [row for row in rows if row["scene"] == scene]
    seeds = [seeds_of(own, method) for method in (OURS, *PLAIN)]
    return [row for row in own if row["seed"] in set.intersection(*seeds)]


def seeds_of(rows: Sequence[Row], method: str) -> set[int]:
    """Seeds of a method, in rows of one scene."""
    return {row["seed"] for row in rows if row["method"] == method}


def line_of(rows: Sequence[Row], method: str, fox: float) -> list[str]:
    """A method of a scene: levels, its bytes against ours, anchors and time."""
    own = [row for row in rows if row["method"] == method]
    levels = [[row for row in own if row["level"] == level] for level in range(4)]
    full, small = map(level_cell, levels), " / ".join(map(own_cell, levels))
    rate = "" if method == OURS else rate_text(rates_of(rows, OURS, method, "full"))
    pixels = own[0]["width"] * own[0]["height"]
    anchors = max(row["anchors"] for row in own) / pixels
    time = mean(row["cpu_seconds"] for row in levels[0])
    cells = [f"{anchors:.2f}", f"{time / 60:.1f}", f"{time / pixels / fox:.1f}"]
    seeds = len(seeds_of(rows, method))
    name = method if seeds == len(seeds_of(rows, OURS)) else f"{method}, seeds: {seeds}"
    return [name, *full, small, rate, *cells]


def table(rows: Sequence[Row]) -> str:
    """All scenes."""
    heads = ["method", "L0, dB in MiB", "L1", "L2", "L3", "own sizes, dB, L0 to L3"]
    heads += ["bytes of ours at equal dB", "anchors a pixel", "CPU min", "time"]
    lines: list[Sequence[str]] = []
    fox = [r for r in of_scene(rows, "fox") if r["method"] == OURS and not r["level"]]
    rate = mean(r["cpu_seconds"] for r in fox) / (fox[0]["width"] * fox[0]["height"])
    for scene in SCENES:
        own = of_scene(rows, scene)
        lines.append([f"{scene_head(own)}, seeds: {len(seeds_of(own, OURS))}"])
        lines += [line_of(own, method, rate) for method in METHODS]
    return table_of(heads, lines)


def verdict(rows: Sequence[Row]) -> str:
    """On how many scenes ours keeps the bar against the best of plain features."""
    worst: dict[str, float] = {}
    for scene in SCENES:
        own = of_scene(rows, scene)
        rates = [mean(r.percent for r in rates_of(own, OURS, plain, "full")) for plain in PLAIN]
        worst[scene] = max(rates)
    kept = [scene for scene, rate in worst.items() if rate <= BAR]
    each = ", ".join(f"{scene} {rate:+.0f} %" for scene, rate in worst.items())
    return (
        f"Bytes of ours against the better of the two plain ones: {each}. "
        f"The aim, {BAR:.0f} % on four scenes of six, is met on {len(kept)}."
    )


def own_sizes(rows: Sequence[Row]) -> str:
    """Levels seen at the sizes of the paper's table I, beside sequential ones trained at them."""
    sizes = [f"L{level} at 1/{1 << (3 - level)}" for level in range(3)]
    heads = ["scene", *(f"{size}, dB / bytes" for size in sizes), "L3, dB / bytes", "aim"]
    lines, kept = list[list[str]](), 0
    for scene in SCENES:
        own = of_scene(rows, scene)
        pairs = [_beside_paper(own, level) for level in range(4)]
        met = [more >= 0 and share <= OWN_BYTES for more, share in pairs]
        kept += all(met)
        missed = ", ".join(f"L{level}" for level in range(4) if not met[level])
        cells = [f"{more:+.1f} / {100 * share:.0f} %" for more, share in pairs]
        lines.append([scene, *cells, f"missed at {missed}" if missed else "met"])
    told = f"The aim, no dB less in at most {OWN_BYTES:.0%} of the bytes, is met on {kept} of six."
    return f"{table_of(heads, lines)}\n\n{told}"


def _beside_paper(rows: Sequence[Row], level: int) -> tuple[float, float]:
    """At a level's own size: dB that ours has more than the paper's preset, its share of bytes."""
    seeds = seeds_of(rows, PAPER)
    ours, paper = (
        [r for r in rows if r["method"] == method and r["level"] == level and r["seed"] in seeds]
        for method in (OURS, PAPER)
    )
    more = mean(r["psnr_own"] for r in ours) - mean(r["psnr_own"] for r in paper)
    return more, mean(r["bytes_compact"] for r in ours) / mean(r["bytes_compact"] for r in paper)


def main() -> None:
    """Gather, write."""
    options = tyro.cli(Options, description=__doc__)
    if options.suite is not None:
        write_rows(ROWS, gathered(options.suite))
    rows = stored_rows(ROWS, TEXT)
    parts = ["### Six scenes", table(rows), verdict(rows)]
    parts += ["### Levels at their own sizes, beside the paper's preset", own_sizes(rows)]
    parts.append(f"{made_by(rows)}.")
    put(PAGE, __file__, "\n\n".join(parts))
    print(PAGE)


if __name__ == "__main__":
    main()
