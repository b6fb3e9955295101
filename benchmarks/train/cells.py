"""Cells of a suite as pages show them: finished rows, heads of scenes, levels."""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import mean

from benchmarks.bench import Row
from research.suites.experiment import finished_rows
from research.suites.run_suite import CELLS
from research.suites.table import spread

MIB = 2**20


def finished_cells(suite: Path) -> Iterator[tuple[Path, list[Row]]]:
    """Folders and rows of the finished cells of a suite, finished or not."""
    for folder in sorted((suite / CELLS).iterdir()):
        rows = finished_rows(folder)
        if rows:
            yield folder, rows


def made_by(rows: Sequence[Row]) -> str:
    """Machines, and the commit that made all rows; ends the script where there are several."""
    machines = sorted({str(row["machine"]) for row in rows if "machine" in row})
    commits = {str(row["commit"]) for row in rows}
    if len(commits) != 1:
        sys.exit(f"rows are of several commits: {', '.join(sorted(commits))}")
    return f"{', '.join(machines)}, commit {commits.pop()}"


def scene_head(rows: Sequence[Row]) -> str:
    """A scene's name, the size of its images and how many measure it."""
    row = rows[0]
    return f"**{row['scene']}**, {row['width']} × {row['height']}, {row['test_photos']} test photos"


def level_cell(rows: Sequence[Row]) -> str:
    """DB in MiB of the packed file, of one level's rows, one for each seed."""
    size = mean(row["bytes_compact"] for row in rows) / MIB
    return f"{spread([row['psnr_full'] for row in rows])} in {size:.3f}"


def levels_text(rows: Sequence[Row]) -> str:
    """All levels of one method on a scene, as `29.30 in 0.065, 32.70 in 0.235`."""
    levels = sorted({row["level"] for row in rows})
    return ", ".join(level_cell([row for row in rows if row["level"] == at]) for at in levels)


def by_scene(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Rows of each scene, scenes in the order in which they come."""
    scenes = dict.fromkeys(row["scene"] for row in rows)
    return {scene: [row for row in rows if row["scene"] == scene] for scene in scenes}


def own_cell(rows: Sequence[Row]) -> str:
    """PSNR at the level's own size, dB, as text."""
    return f"{mean(row['psnr_own'] for row in rows):.1f}"
