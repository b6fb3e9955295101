"""The papers' data sets: docs/results/standard.md from a suite, finished or not.

python -m research suites/standard.toml --data DATA --lpips WEIGHTS --out STANDARD
python -m benchmarks.train.standard STANDARD
"""

from collections.abc import Sequence
from pathlib import Path
from statistics import mean

import tyro
from tyro.conf import Positional

from benchmarks.bench import RESULTS, Row, put, table_of, write_rows
from benchmarks.train.cells import finished_cells, made_by
from research.suites.paper import PaperTable, level_table

PAGE, ROWS = (RESULTS / f"standard.{kind}" for kind in ("md", "csv"))
PUBLISHED = {
    "truck": 25.2,
    "train": 21.1,
    "playroom": 30.0,
    "drjohnson": 28.8,
    "bonsai": 32.2,
    "garden": 27.4,
}
"""PSNR of 3DGS after 30,000 steps as its authors give it, dB."""
WITHIN = 0.3
"""Decibels within which our 3DGS has to come, else renderer or protocol differ from theirs."""


def protocol(rows: Sequence[Row]) -> str:
    """3DGS here beside its authors' figures."""
    told: list[str] = []
    for scene, known in PUBLISHED.items():
        own = [r for r in rows if (r["scene"], r["method"]) == (scene, "gaussians")]
        if own:
            finest = max(row["level"] for row in own)
            found = mean(row["psnr_full"] for row in own if row["level"] == finest)
            verdict = "as published" if abs(found - known) <= WITHIN else "**not as published**"
            told.append(f"{scene} {found:.2f} dB ({known:.1f}: {verdict})")
    return f"3DGS: {', '.join(told) or 'none of the scenes whose figures are known'}."


def shown(table: PaperTable) -> str:
    """A table as Markdown."""
    return table_of(list(table.columns), [list(line) for line in table.lines])


def main(folder: Positional[Path]) -> None:
    """Gather, write.

    Args:
        folder: Folder of the suite.
    """
    rows = [row for _, own in finished_cells(folder) for row in own]
    made = made_by(rows)
    write_rows(ROWS, rows)
    scenes = ", ".join(dict.fromkeys(row["scene"] for row in rows))
    about = f"Means over {scenes}; levels at the scale of the run. {made}."
    put(PAGE, __file__, "\n\n".join([shown(level_table(rows, "full")), protocol(rows), about]))
    print(PAGE, ROWS, sep="\n")


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
