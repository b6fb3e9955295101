"""A suite from its cells to its table; finished cells are not run again."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from gsynopsis.files import publish
from gsynopsis.jobs.process_pool import on_ray, on_this_machine
from gsynopsis.runs.folder import make_folder
from research.suites.experiment import Row, check_versions, finished_rows, run_cell, scene_folder
from research.suites.suite import Cell, Suite
from research.suites.table import suite_csv, suite_page

CELLS = "cells"
Task: TypeAlias = tuple[Cell, Path, Path]
"""A cell, its folder, and that of procedural scenes."""


@dataclass(frozen=True)
class Places:
    """Folders of a suite's results and of its procedural scenes."""

    out: Path
    cache: Path


@dataclass(frozen=True)
class Outcomes:
    """Outcome of a suite: its files, and a line for each cell without rows."""

    files: tuple[Path, ...]
    failed: tuple[str, ...]


def run_suite(
    suite: Suite,
    title: str,
    places: Places,
    *,
    jobs: int = 1,
    ray: str | None = None,
    tick: Callable[[int, int], None] | None = None,
) -> Outcomes:
    """Run the unfinished cells, then write `results.html`; `results.csv` after each cell.

    Args:
        suite: Checked, see `read_suite`.
        title: Title of the page.
        places: Folders.
        jobs: Processes on this machine.
        ray: Address of a Ray cluster that runs the cells instead.
        tick: Called with cells done and cells in all.

    Raises:
        SettingError: a cell is half finished by another version, or a folder cannot be used.
        MissingExtraError: Ray is wanted and not installed.
    """
    cells = places.out.resolve() / CELLS
    cache = places.cache.resolve()
    make_folder(cells)
    for cell in suite.cells:
        check_versions(cell, cells)
        scene_folder(cell, cache)
    rows: dict[str, list[Row]] = {}
    todo: dict[str, Task] = {}
    for cell in suite.cells:
        known = finished_rows(cells / cell.name)
        if known is None:
            todo[cell.name] = (cell, cells / cell.name, cache)
        else:
            rows[cell.name] = known
    failed, done = list[str](), len(suite.cells) - len(todo)
    for name, found in _ended(todo, jobs, ray):
        if isinstance(found, str):
            failed.append(f"{todo[name][0].stem}: {found}")
        else:
            rows[name] = found
            _write_table(suite, rows, places)
        done += 1
        if tick:
            tick(done, len(suite.cells))
    table, files = _write_table(suite, rows, places)
    if table:
        page = suite_page(title, table, suite.anchor)
        files = (*files, publish(places.out / "results.html", page))
    return Outcomes(files, tuple(failed))


def _write_table(
    suite: Suite, rows: Mapping[str, list[Row]], places: Places
) -> tuple[list[Row], tuple[Path, ...]]:
    """All rows that there are, in the suite's order, and their file; none where there are none."""
    table = [row for cell in suite.cells for row in rows.get(cell.name, [])]
    path = places.out / "results.csv"
    return table, (publish(path, suite_csv(table)),) if table else ()


def _ended(
    todo: Mapping[str, Task], jobs: int, ray: str | None
) -> Iterator[tuple[str, list[Row] | str]]:
    """Cells as they end."""
    for wave in _waves(todo):
        yield from on_ray(run_cell, wave, ray) if ray else on_this_machine(run_cell, wave, jobs)


def _waves(todo: Mapping[str, Task]) -> list[Mapping[str, Task]]:
    """Cells that wait for no other of their wave: of each seed those that unfold come last."""
    if not any(cell.unfolds for cell, _, _ in todo.values()):
        return [todo] if todo else []
    waves = dict[tuple[int, bool], dict[str, Task]]()
    for name, task in todo.items():
        waves.setdefault((task[0].seed, task[0].unfolds is not None), {})[name] = task
    seeds = list(dict.fromkeys(seed for seed, _ in waves))
    order = [(seed, late) for seed in seeds for late in (False, True)]
    return [waves[key] for key in order if key in waves]
