"""Cells on workers: processes of this machine, or those of a Ray cluster."""

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

from gsynopsis.bench.cell import Row, run_cell
from gsynopsis.bench.suite import Cell
from gsynopsis.errors import MissingExtraError, SettingError, SpaceError

Ended = tuple[Cell, list[Row] | str]
"""A cell, and its rows or why there are none."""
Job = tuple[Cell, Path, Path]
"""Arguments of `run_cell`."""


def on_this_machine(jobs: Sequence[Job], processes: int) -> Iterator[Ended]:
    """Cells as they end, so many at once, each in a process that ends with it.

    Raises:
        SpaceError: a process was killed, most likely for memory.
    """
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, context, max_tasks_per_child=1) as pool:
        futures = {pool.submit(run_cell, *job): job[0] for job in jobs}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BrokenProcessPool as error:
            advice = "start again: finished cells are kept; fewer --jobs take less memory"
            found = "a process that was killed"
            raise SpaceError("--jobs", found=found, advice=advice) from error
        finally:
            pool.shutdown(cancel_futures=True)


def on_ray(jobs: Sequence[Job], address: str) -> Iterator[Ended]:
    """Cells as they end on a Ray cluster; those of a worker that dies run again elsewhere.

    All machines need the same folders, as on a network file system, and this version.

    Args:
        jobs: What to run.
        address: Of the cluster, or `local` for one on this machine while it is needed.

    Raises:
        MissingExtraError: Ray is not installed.
        SettingError: there is no such cluster.
    """
    try:
        import ray  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise MissingExtraError("ray", "ray") from error
    cluster: Any = ray
    try:
        cluster.init(address=address, log_to_driver=False, logging_level="error")
    except Exception as error:  # Ray raises it bare where a node does not start in time
        raise SettingError("--ray", found=error, expected="a Ray cluster") from error
    try:
        # A process ends with its cell, so that its peak of memory is the cell's.
        remote = cluster.remote(max_calls=1, max_retries=3, num_cpus=1)(run_cell)
        waiting = {remote.remote(*job): job[0] for job in jobs}
        while waiting:
            done, _ = cluster.wait(list(waiting))
            for reference in done:
                yield waiting.pop(reference), cluster.get(reference)
    finally:
        cluster.shutdown()
