"""Independent jobs on workers: processes of this machine, or those of a Ray cluster."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.context import BaseContext
from typing import Any, TypeVar

from gsynopsis.errors import MissingExtraError, SettingError, SpaceError
from gsynopsis.interrupt import held_signals

Key = TypeVar("Key")
Result = TypeVar("Result")
Arguments = tuple[Any, ...]
RAY_RETRIES = 3
"""Times that Ray runs a job again whose worker died."""
PATIENCE = 2.0
"""Seconds between looks at how far jobs are, where somebody looks."""


def on_this_machine(
    work: Callable[..., Result],
    jobs: Mapping[Key, Arguments],
    processes: int,
    retries: int = 0,
    look: Callable[[], None] | None = None,
) -> Iterator[tuple[Key, Result]]:
    """Results of jobs as they end, so many at once, each in a process that ends with it.

    Args:
        work: A function of a module, so that other processes find it.
        jobs: Its arguments by a name for each job.
        processes: At once.
        retries: Times that what was not done is begun again after a process was killed.
        look: Called now and then while jobs run.

    Raises:
        SpaceError: a process was killed once more, most likely for memory.
    """
    left = dict(jobs)
    while left:
        try:
            for key, result in _on_a_pool(work, left, processes, look):
                del left[key]
                yield key, result
        except BrokenProcessPool as error:
            if retries > 0:
                retries -= 1
                continue
            advice = "start again: what is finished is kept; fewer --jobs take less memory"
            found = "a process that was killed"
            raise SpaceError("--jobs", found=found, advice=advice) from error


def _on_a_pool(
    work: Callable[..., Result],
    jobs: Mapping[Key, Arguments],
    processes: int,
    look: Callable[[], None] | None,
) -> Iterator[tuple[Key, Result]]:
    with ProcessPoolExecutor(
        processes, _context(work), initializer=end_with_parent, max_tasks_per_child=1
    ) as pool:
        try:
            # A process whose beginning is broken off would end in a traceback.
            with held_signals():
                futures = {pool.submit(work, *job): key for key, job in jobs.items()}
            pending = set(futures)
            while pending:
                done, pending = wait(pending, look and PATIENCE, FIRST_COMPLETED)
                for future in done:
                    yield futures[future], future.result()
                if look:
                    look()
        except KeyboardInterrupt:
            for child in multiprocessing.active_children():
                child.terminate()  # asks a training to save itself
            raise
        finally:
            pool.shutdown(cancel_futures=True)


def _context(work: Callable[..., object]) -> BaseContext:
    """A server without threads of its own forks each process: torch is imported once for all."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([work.__module__])
    return context


def end_with_parent() -> None:
    """Ask this process to end, as Ctrl-C would, once the one that began it is gone, killed too."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=follow, daemon=True).start()


def on_ray(
    work: Callable[..., Result],
    jobs: Mapping[Key, Arguments],
    address: str,
    look: Callable[[], None] | None = None,
) -> Iterator[tuple[Key, Result]]:
    """Results of jobs as they end on a Ray cluster; those of a worker that dies run elsewhere.

    All machines need the same folders, as on a network file system, and this version.

    Args:
        work: A function of a module.
        jobs: Its arguments by a name for each job.
        address: Of the cluster, or `local` for one on this machine while it is needed.
        look: Called now and then while jobs run.

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
        # A process ends with its job, so that its peak of memory is the job's.
        remote = cluster.remote(max_calls=1, max_retries=RAY_RETRIES, num_cpus=1)(work)
        waiting = {remote.remote(*job): key for key, job in jobs.items()}
        while waiting:
            done, _ = cluster.wait(list(waiting), timeout=look and PATIENCE)
            for reference in done:
                yield waiting.pop(reference), cluster.get(reference)
            if look:
                look()
    finally:
        cluster.shutdown()
