"""A folder has one training at a time, and a kill leaves nothing that stays."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from gsynopsis import cli
from gsynopsis.errors import InputError, SettingError
from gsynopsis.runs.lock import LOCK_FILE, clear_drafts, run_lock
from gsynopsis.synthetic.make_scene import make_scene

HOLDER = """
import sys, time
from pathlib import Path
from gsynopsis.runs.lock import run_lock
with run_lock(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""


def test_a_second_claim_is_refused_with_the_process_and_the_time(tmp_path: Path) -> None:
    when = r"since \d{4}-\d\d-\d\d \d\d:\d\d:\d\d"
    wanted = rf"{re.escape(str(tmp_path))}: found a training in it: process {os.getpid()} on .*"
    with run_lock(tmp_path):
        with pytest.raises(SettingError, match=wanted + when), run_lock(tmp_path):
            pytest.fail("claimed twice")
        assert (tmp_path / LOCK_FILE).exists()
    assert not list(tmp_path.iterdir())
    with run_lock(tmp_path):
        pass


def test_a_killed_process_holds_nothing(tmp_path: Path) -> None:
    line = [sys.executable, "-c", HOLDER, str(tmp_path)]
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None and child.stdout.readline() == "held\n"
        with pytest.raises(SettingError, match=f"process {child.pid} on"), run_lock(tmp_path):
            pytest.fail("claimed twice")
        child.kill()
        child.wait(timeout=60)
    assert (tmp_path / LOCK_FILE).exists()
    with run_lock(tmp_path):
        assert f"process {os.getpid()} on" in (tmp_path / LOCK_FILE).read_text()


def test_drafts_of_a_killed_process_are_removed_and_nothing_else(tmp_path: Path) -> None:
    gone = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], text=True,
                          capture_output=True, check=True).stdout.strip()  # fmt: skip
    left = ("checkpoint.tmp", "full.tmp", "run.json.tmp", f".scene.{gone}.gsyn")
    left += (f".scene.gsyn.{gone}.tmp", f".metrics.{gone}.json", f".contact.{gone}.png")
    kept = ("checkpoint.safetensors", "scene.gsyn", "notes.tmp", f".metrics.{os.getppid()}.json")
    kept += (".scene.gsyn.swp", "run.json")
    for name in (*left, *kept):
        (tmp_path / name).write_text("x")
    clear_drafts(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(kept)


def test_a_second_training_is_refused_and_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    room = make_scene("room", tmp_path / "room", views=4, width=16, height=12, points=40)
    run = tmp_path / "run"
    run.mkdir()
    with run_lock(run):
        before = {path.name: path.read_bytes() for path in run.iterdir()}
        words = ["train", str(room), "--out", str(run), "--steps", "1", "--quiet"]
        assert cli.main(words) == 2
        assert {path.name: path.read_bytes() for path in run.iterdir()} == before
    error = capsys.readouterr().err
    assert f"found a training in it: process {os.getpid()}" in error and error.count("\n") == 1


@pytest.mark.parametrize("kind", ["link", "hard link", "pipe", "dangling link", "folder"])
def test_a_lock_that_is_no_file_of_its_own_is_refused_untouched(tmp_path: Path, kind: str) -> None:
    run, secret = tmp_path / "run", tmp_path / "secret"
    run.mkdir()
    secret.write_text("mine")
    lock = run / LOCK_FILE
    if kind == "link":
        lock.symlink_to(secret)
    elif kind == "hard link":
        os.link(secret, lock)
    elif kind == "pipe":
        os.mkfifo(lock)
    elif kind == "folder":
        lock.mkdir()
    else:
        lock.symlink_to(tmp_path / "new")
    with pytest.raises(InputError, match=r"training.lock: found a link, or no regular file"):  # noqa: SIM117
        with run_lock(run):
            pytest.fail("claimed")
    assert secret.read_text() == "mine" and not (tmp_path / "new").exists()


def test_drafts_of_today_and_of_libraries_are_removed(tmp_path: Path) -> None:
    (tmp_path / ".checkpoint.safetensors.999999999.abcd_123.draft").mkdir()
    (tmp_path / ".tmpAbC123").write_text("x")
    (tmp_path / ".tmp").write_text("mine")
    clear_drafts(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [".tmp"]
