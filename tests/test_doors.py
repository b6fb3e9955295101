"""A part of benchmarks/robust/doors.py in every test run: every door, ten seconds in all."""

import json
import mmap
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.robust import doors as fuzzer
from benchmarks.robust.examples import DOORS, Door, written
from benchmarks.robust.fuzz import on_alarm
from gsynopsis.errors import GsynopsisError

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="not Linux: doors NOT tried")
ROOT = Path(__file__).parents[1]
VIDEO, FFMPEG = "video", shutil.which("ffmpeg")
NAMES = [door.name for door in DOORS]
SECONDS = 10
"""For all of them: in memory that is as many inputs as 20 seconds were on a disk."""


@pytest.fixture(scope="module")
def passed() -> dict[str, Any]:
    """Counts of all doors, tried by one process: each would import torch."""
    doors = [name for name in NAMES if FFMPEG or not name.startswith(VIDEO)]
    line = [sys.executable, "-m", "benchmarks.robust.doors", "--json", "--only", *doors]
    line += ["--seconds", str(SECONDS / len(doors))]
    done = subprocess.run(line, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode in (0, 1), done.stderr
    found = json.loads(done.stdout)
    assert found.keys() == set(doors)
    return found


@pytest.mark.parametrize("name", NAMES)
def test_spoilt_inputs_end_in_a_result_or_in_one_line(name: str, passed: dict[str, Any]) -> None:
    if name.startswith(VIDEO) and not FFMPEG:
        pytest.skip("no ffmpeg: videos NOT tried")
    assert not passed[name]["trouble"]
    assert passed[name]["tried"] == passed[name]["accepted"] + passed[name]["refused"] > 0


def take(folder: Path) -> None:
    # Pages of its own: a heap that earlier trainings left in this process would not grow.
    memory = np.frombuffer(mmap.mmap(-1, fuzzer.MEMORY + (16 << 20)), np.uint8)
    memory[:] = 1


def wait(folder: Path) -> None:
    while True:
        pass


def reach_out(folder: Path) -> None:
    # By a program of its own, as ffmpeg would.
    subprocess.run(["cat", folder.parent / "secret" / "file"], check=True, capture_output=True)


def stumble(folder: Path) -> None:
    raise KeyError("a")


def say_much(folder: Path) -> None:
    raise GsynopsisError("x" * 5000)


@pytest.mark.parametrize(
    ("use", "count"),
    [
        (take, "memory"),
        (wait, "hangs"),
        (reach_out, "outside"),
        (stumble, "tracebacks"),
        (say_much, "tracebacks"),
    ],
)
def test_a_reader_out_of_bounds_is_counted(
    use: Callable[[Path], None], count: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fuzzer, "MEMORY", 32 << 20)
    monkeypatch.setattr(fuzzer, "HANG_SECONDS", 0.2)
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret" / "file").write_text("secret")
    tried: list[Path] = []

    def read(folder: Path) -> None:
        tried.append(folder)
        if len(tried) > 1:  # the example itself is read first
            use(folder)

    before = signal.signal(signal.SIGPROF, on_alarm)
    door = Door("door", written("a.ply", lambda: b"x" * 1000), read)
    options = fuzzer.Options(count=1, seed=2)
    passed = fuzzer.try_door(door, options, tmp_path, fuzzer.Watch(tmp_path / "secret"))
    signal.signal(signal.SIGPROF, before)
    assert passed.failed == getattr(passed, count) == 1 and len(passed.trouble) == 1
