"""Tests of jobs on processes of this machine."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gsynopsis.jobs import process_pool
from gsynopsis.jobs.process_pool import on_this_machine

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks into /proc")

PARENT = """
import sys
from gsynopsis.jobs.process_pool import on_this_machine
from tests.jobs.test_process_pool import say_and_wait

if __name__ == "__main__":
    list(on_this_machine(say_and_wait, {"a": (sys.argv[1],)}, 1))
"""
ROOT = Path(__file__).parents[2]


def say_and_wait(path: str) -> None:
    """A job that says which process it is in, and lasts longer than any test."""
    part = Path(path).with_suffix(".part")
    part.write_text(str(os.getpid()))
    part.rename(path)
    time.sleep(600)


@pytest.mark.parametrize("kind", [signal.SIGTERM, signal.SIGKILL])
def test_a_job_ends_with_the_process_that_ordered_it(tmp_path: Path, kind: signal.Signals) -> None:
    script, said = tmp_path / "parent.py", tmp_path / "pid"
    script.write_text(PARENT)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen([sys.executable, script, said], env=environment) as parent:
        until = time.monotonic() + 60
        while not said.exists() and time.monotonic() < until:
            time.sleep(0.05)
        job = int(said.read_text())
        parent.send_signal(kind)
    until = time.monotonic() + 30
    while _lives(job) and time.monotonic() < until:
        time.sleep(0.05)
    assert not _lives(job)


def _lives(process: int) -> bool:
    """Whether a process runs; one that has ended may still wait for somebody to ask how."""
    try:
        stat = Path(f"/proc/{process}/stat").read_text()
    except FileNotFoundError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


def test_whoever_waits_for_workers_may_look_meanwhile(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process_pool, "PATIENCE", 0.05)
    looks: list[int] = []
    jobs = {"a": (0.6,), "b": (0.0,)}
    ended = dict(on_this_machine(time.sleep, jobs, 1, look=lambda: looks.append(1)))
    assert ended == {"a": None, "b": None} and len(looks) > 3
