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
STOPPED = """
import sys
from gsynopsis.jobs.process_pool import on_this_machine
from tests.jobs.test_process_pool import say_and_wait

if __name__ == "__main__":
    print("now", flush=True)
    try:
        list(on_this_machine(say_and_wait, {"a": (sys.argv[1],), "b": (sys.argv[1],)}, 1))
    except KeyboardInterrupt:
        sys.exit(3)
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


@pytest.mark.parametrize("late", [0.05, 0.3])
def test_ctrl_c_while_the_first_job_begins_is_no_traceback(tmp_path: Path, late: float) -> None:
    """Its process is begun by a server that loads libraries first, which takes seconds."""
    script = tmp_path / "parent.py"
    script.write_text(STOPPED)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    line = [sys.executable, script, tmp_path / "pid"]
    pipe = subprocess.PIPE
    with subprocess.Popen(
        line, env=environment, stdout=pipe, stderr=pipe, preexec_fn=_heeds_ctrl_c
    ) as parent:
        assert parent.stdout is not None
        parent.stdout.readline()
        time.sleep(late)
        parent.send_signal(signal.SIGINT)
        said = parent.communicate()[1].decode()
    assert parent.returncode == 3 and not said


def _heeds_ctrl_c() -> None:
    """Processes of a job in the background ignore it."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


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
