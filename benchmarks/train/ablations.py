"""Contribution of each of the paper's modules: docs/results/ablations.md.

    python -m research suites/ablations.toml --out RUNS
    python -m benchmarks.train.ablations RUNS

Copies the rows of finished cells into docs/results/ablations.csv. Without folders the page is
written again from the CSV.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean

import tyro
from tyro.conf import Positional

from benchmarks.bench import RESULTS, Row, put, stored_rows, table_of, write_rows
from benchmarks.train.cells import MIB, finished_cells, made_by, scene_head
from research.suites.table import spread

PAGE, ROWS = (RESULTS / f"ablations.{kind}" for kind in ("md", "csv"))
TEXT = ("scene", "method", "split", "version", "commit", "machine")
FULL = "full"
METHODS = (
    *(FULL, "base", "LAD", "CBM", "LAD, frozen codebook"),
    *("group weight 0", "group weight 3", "ratios imposed", "full resolution"),
    *("tables a quarter", "tables sixteenfold"),
)
COARSER = range(3)
"""Levels that unfolding makes: the finest is the full model's."""


@dataclass(frozen=True)
class Options:
    """Options of the page.

    Attributes:
        folders: Folders of suites; none: the page alone.
    """

    folders: Positional[tuple[Path, ...]] = ()


def gathered(folders: Sequence[Path]) -> list[Row]:
    """Rows of all finished cells, scenes by their image sizes."""
    rows = [row for folder in folders for _, own in finished_cells(folder) for row in own]
    return sorted(
        rows, key=lambda r: (r["scene"], r["width"], METHODS.index(r["method"]), r["seed"])
    )


def cases_of(rows: Sequence[Row]) -> list[list[Row]]:
    """Rows of each scene and image size."""
    cases: dict[tuple[str, int], list[Row]] = {}
    for row in rows:
        cases.setdefault((row["scene"], row["width"]), []).append(row)
    return list(cases.values())


def values_of(rows: Sequence[Row], method: str, level: int, name: str) -> dict[int, float]:
    """A column by seed."""
    return {r["seed"]: r[name] for r in rows if r["method"] == method and r["level"] == level}


def cell_of(rows: Sequence[Row], method: str, level: int, name: str, form: str) -> str:
    """A value of the whole method; for others their difference from it, seed by seed."""
    own, full = (values_of(rows, m, level, name) for m in (method, FULL))
    if method == FULL:
        return spread(list(own.values()), form)
    return spread([own[seed] - full[seed] for seed in sorted(own)], f"+{form}")


def line_of(rows: Sequence[Row], method: str, kind: str) -> list[str]:
    """A method of a scene."""
    db = [cell_of(rows, method, level, f"psnr_{kind}", ".2f") for level in COARSER]
    similar = [cell_of(rows, method, level, f"ssim_{kind}", ".3f") for level in COARSER]
    sizes = [mean(values_of(rows, method, level, "bytes_compact").values()) for level in range(4)]
    finest = spread(list(values_of(rows, method, 3, "psnr_full").values()))
    return [method, *db, *similar, finest, " / ".join(f"{size / MIB:.2f}" for size in sizes)]


def table(rows: Sequence[Row], kind: str) -> str:
    """All methods of all scenes, at the levels' own sizes or at the run's."""
    heads = ["method", *(f"L{level}, dB" for level in COARSER)]
    heads += [*(f"L{level}, SSIM" for level in COARSER), "L3, dB", "packed, MiB, L0 to L3"]
    lines: list[Sequence[str]] = []
    for own in cases_of(rows):
        known = {row["method"] for row in own}
        seeds = len({row["seed"] for row in own})
        lines.append([f"{scene_head(own)}, seeds: {seeds}"])
        lines += [line_of(own, method, kind) for method in METHODS if method in known]
    return table_of(heads, lines)


def main() -> None:
    """Gather, write."""
    options = tyro.cli(Options, description=__doc__)
    if options.folders:
        write_rows(ROWS, gathered(options.folders))
    rows = stored_rows(ROWS, TEXT)
    told = f"{made_by(rows)}."
    parts = [table(rows, "own"), "### Seen at the size of the run", table(rows, "full"), told]
    put(PAGE, __file__, "\n\n".join(parts))
    print(PAGE)


if __name__ == "__main__":
    main()
