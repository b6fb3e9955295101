"""Contribution of each of the paper's modules: docs/results/ablations.md.

    python -m research suites/ablations.toml --data DATA --out RUNS
    python -m benchmarks.train.ablations RUNS

Copies the rows of finished cells into docs/results/ablations.csv. Without folders the page is
written again from the CSV.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro
from tyro.conf import Positional

from benchmarks.bench import RESULTS, Row, put, stored_rows, table_of, write_rows
from benchmarks.train.cells import finished_cells, made_by, scene_head
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


def table(rows: Sequence[Row]) -> str:
    """All methods at the levels' own sizes, a column for each scene and coarser level."""
    cases = cases_of(rows)
    heads = ["method"]
    for own in cases:
        heads += [f"{own[0]['scene']} {own[0]['width']}, L0, dB", "L1", "L2"]
    lines: list[Sequence[str]] = []
    for method in METHODS:
        line = [method]
        for own in cases:
            known = any(row["method"] == method for row in own)
            line += [
                cell_of(own, method, level, "psnr_own", ".2f") if known else "–"
                for level in COARSER
            ]
        lines.append(line)
    return table_of(heads, lines)


def about(rows: Sequence[Row]) -> str:
    """Scenes, sizes, test photos and seeds."""
    return "; ".join(
        f"{scene_head(own)}, seeds: {len({row['seed'] for row in own})}" for own in cases_of(rows)
    )


def main() -> None:
    """Gather, write."""
    options = tyro.cli(Options, description=__doc__)
    if options.folders:
        write_rows(ROWS, gathered(options.folders))
    rows = stored_rows(ROWS, TEXT)
    put(PAGE, __file__, f"{table(rows)}\n\n{about(rows)}. {made_by(rows)}.")
    print(PAGE)


if __name__ == "__main__":
    main()
