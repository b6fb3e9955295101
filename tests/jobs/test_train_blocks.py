"""Scenes in blocks: divided, trained by processes and by Ray, joined into one file."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch

import gsynopsis as gs
from gsynopsis.cli import main
from gsynopsis.errors import SettingError
from gsynopsis.jobs import process_pool as workers
from gsynopsis.jobs import train_blocks as blocks_
from gsynopsis.jobs.process_pool import on_this_machine
from gsynopsis.jobs.train_blocks import (
    BLOCKS,
    PLAN,
    STEPS_FILE,
    WHOLE,
    Division,
    StepsWritten,
    steps_written,
)
from gsynopsis.synthetic.make_scene import make_scene
from gsynopsis.training.observer import StepInfo
from gsynopsis.training.sub_scene import Region

SETTINGS = (
    *("--set", "train.steps=100", "levels.steps=40", "model.hidden=8", "model.slots=4"),
    *("train.growth.every=10", "levels.prune_share=0.001"),
)
QUICK = ("--no-evaluate", "--quiet")


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("town") / "town"
    return make_scene("city", out, views=40, width=48, height=32, points=900)


def command(town: Path, out: Path, *more: str, blocks: int = 3) -> list[str]:
    asked = ["train", str(town), "--out", str(out), "--blocks", str(blocks)]
    return [*asked, *QUICK, *more, *SETTINGS]


@pytest.fixture(scope="module")
def done(town: Path) -> Path:
    out = town.parent / "done"
    assert main(command(town, out, "--jobs", "2")) == 0
    return out


def test_blocks_are_one_valid_file_about_as_good_as_the_whole(done: Path) -> None:
    levels = gs.check(done / "scene.gsyn")
    assert len(levels) == 4
    with gs.open(done / "scene.gsyn") as joined, gs.open(done / WHOLE / "scene.gsyn") as whole:
        fine, coarse = joined.levels[-1], whole.levels[-1]
        # So few steps are no gain, docs/results/scale.md has that; a wrong join costs more.
        assert fine.quality["psnr_full"] > coarse.quality["psnr_full"] - 1.0
        assert fine.bytes < coarse.bytes
    plan = json.loads((done / BLOCKS / PLAN).read_text())["blocks"]
    assert len(plan) == 3
    assert all(8 <= len(block["views"]) <= 35 for block in plan)
    # Each box has two infinite sides at least: three boxes are cut along one or two axes.
    assert all(block["own"]["low"].count(None) >= 1 for block in plan)


def test_anchors_of_the_result_are_those_of_their_blocks(done: Path) -> None:
    """No anchor is there twice, none of another block's margin."""
    with gs.open(done / "scene.gsyn") as joined:
        cells = joined.level_set().shared.lattice
    assert len(np.unique(cells, axis=0)) == len(cells)


def test_a_second_start_trains_nothing(
    town: Path, done: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = (done / "scene.gsyn").read_bytes()

    def refuse(*jobs: object) -> list[object]:
        raise AssertionError("a finished block was trained again")

    monkeypatch.setattr(blocks_, "on_this_machine", refuse)
    assert main(command(town, done, "--jobs", "2")) == 0
    assert (done / "scene.gsyn").read_bytes() == before


def kill_one(folder: Path, deadline: float) -> bool:
    """End the process that trains in a block's folder, by its lock."""
    while time.monotonic() < deadline:
        for lock in folder.glob(f"{BLOCKS}/*/training.lock"):
            try:
                words = lock.read_text().split()
                if len(words) > 1 and int(words[1]) != os.getpid():
                    os.kill(int(words[1]), signal.SIGKILL)
                    return True
            except (OSError, ValueError):
                continue
        time.sleep(0.005)
    return False


def killed(town: Path, out: Path, *more: str) -> None:
    """Train in a process of its own, and kill a worker meanwhile."""
    words = [sys.executable, "-m", "gsynopsis", *command(town, out, *more)]
    environment = {**os.environ, "RAY_memory_monitor_refresh_ms": "0"}
    with subprocess.Popen(words, env=environment, cwd=town.parent) as process:
        assert kill_one(out, time.monotonic() + 200)
        assert process.wait(300) == 0


def test_a_killed_worker_s_block_is_trained_again_and_the_file_is_the_same(
    town: Path, done: Path, tmp_path: Path
) -> None:
    killed(town, tmp_path / "out", "--jobs", "1")
    assert (tmp_path / "out" / "scene.gsyn").read_bytes() == (done / "scene.gsyn").read_bytes()


@pytest.mark.slow
def test_ray_gives_the_same_file_also_when_a_worker_is_killed(
    town: Path, done: Path, tmp_path: Path
) -> None:
    pytest.importorskip("ray")
    killed(town, tmp_path / "out", "--ray", "local")
    assert (tmp_path / "out" / "scene.gsyn").read_bytes() == (done / "scene.gsyn").read_bytes()


def test_a_block_that_fails_is_named_and_the_others_are_kept(
    town: Path, done: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    (out / BLOCKS).mkdir(parents=True)
    (out / BLOCKS / "0001").write_text("a file where the block's folder should be")
    assert main(command(town, out, "--jobs", "2")) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert "block 1: found" in line and "the others are kept: repeat the command" in line
    assert sorted(p.parent.name for p in (out / BLOCKS).glob("*/checkpoint.*")) == ["0000", "0002"]
    assert gs.check(out / WHOLE / "scene.gsyn")
    assert not (out / "scene.gsyn").exists()
    (out / BLOCKS / "0001").unlink()
    assert main(command(town, out)) == 0
    assert (out / "scene.gsyn").read_bytes() == (done / "scene.gsyn").read_bytes()


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--blocks", "1"), "--blocks: found 1, expected 2 to 1,000"),
        (("--blocks", "0", "--jobs", "2"), "--jobs: found no blocks, expected --blocks N"),
        (("--viewer",), "--viewer: found --blocks, expected one training"),
        (("--max-memory", "0.5", "--jobs", "2"), "found 0.5 GiB for 2 jobs, expected for each at "),
        (("--levels", "sequential"), "levels.mode: found sequential, expected joint"),
        (("--preset", "paper"), "levels.mode: found sequential, expected joint"),
    ],
)
def test_what_cannot_be_trained_in_blocks_is_one_line(
    town: Path, tmp_path: Path, more: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [w for w in command(town, tmp_path / "out", *more) if "prune_share" not in w]
    assert main(words) == 2
    err = capsys.readouterr().err
    assert said in err and err.count("\n") == 1
    assert not (tmp_path / "out" / WHOLE).exists()


def test_another_number_of_blocks_in_the_same_folder_is_refused(
    town: Path, done: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (done / "scene.gsyn").read_bytes()
    assert main(command(town, done, blocks=4)) == 2
    assert "--blocks: found 4, expected 3" in capsys.readouterr().err
    assert (done / "scene.gsyn").read_bytes() == before


def test_photos_of_a_block_are_those_that_show_it() -> None:
    shares = np.array([0.0, 0.04, 0.5, 0.06, 0.0, 0.01, 0.02, 0.03, 0.3, 0.049, 0.001])
    # Eight at least, but none that shows nothing of it.
    chosen = blocks_.views_of(range(100, 111), shares)
    assert chosen == (101, 102, 103, 105, 106, 107, 108, 109), (
        "eight at least, none that shows none"
    )
    assert blocks_.views_of(range(3), np.zeros(3)) == ()
    assert blocks_.views_of(range(20), np.full(20, 0.2)) == tuple(range(20))


def test_a_division_needs_two_blocks() -> None:
    with pytest.raises(SettingError, match="2 to 1,000"):
        Division(1)


def test_a_region_s_low_faces_are_its_own() -> None:
    x = torch.tensor([[0.0, 0, 0], [1.0, 0, 0]])
    assert Region(low=(0.0, 0.0, 0.0), high=(1.0, 1.0, 1.0)).holds(x).tolist() == [True, False]


def test_a_block_says_how_far_it_is(tmp_path: Path) -> None:
    assert steps_written(tmp_path) == 0
    (tmp_path / STEPS_FILE).write_text("half a num")
    assert steps_written(tmp_path) == 0
    written = StepsWritten(tmp_path)
    step = StepInfo("full", 1, 10, loss=0.1, psnr=20.0, anchors=5, memory=0)
    for _ in range(3):
        written.on_step(step)
    assert written.done == 3 and steps_written(tmp_path) == 1, "at most every two seconds"


def test_whoever_waits_for_workers_may_look_meanwhile(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "PATIENCE", 0.05)
    looks: list[int] = []
    jobs = {"a": (0.6,), "b": (0.0,)}
    ended = dict(on_this_machine(time.sleep, jobs, 1, look=lambda: looks.append(1)))
    assert ended == {"a": None, "b": None} and len(looks) > 3
