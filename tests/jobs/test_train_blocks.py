"""Scenes in blocks: divided, trained by processes and by Ray, joined into one file."""

import json
import os
import shutil
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import gsynopsis as gs
from gsynopsis.cli import main
from gsynopsis.errors import SettingError
from gsynopsis.jobs import train_blocks
from gsynopsis.jobs.plan_blocks import BLOCKS, PLAN, WHOLE
from gsynopsis.jobs.train_blocks import Division
from gsynopsis.synthetic.make_scene import make_scene

SETTINGS = (
    *("--set", "train.steps=40", "levels.steps=12", "model.hidden=8", "model.slots=4"),
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

    monkeypatch.setattr(train_blocks, "on_this_machine", refuse)
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


def killed(town: Path, done: Path, out: Path, *more: str) -> None:
    """Train the blocks of a whole that is there, and kill a worker meanwhile."""
    shutil.copytree(done / WHOLE, out / WHOLE)
    with ThreadPoolExecutor() as other:
        kill = other.submit(kill_one, out, time.monotonic() + 200)
        assert main(command(town, out, *more)) == 0
        assert kill.result()


def test_a_killed_worker_s_block_is_trained_again_and_the_file_is_the_same(
    town: Path, done: Path, tmp_path: Path
) -> None:
    killed(town, done, tmp_path / "out", "--jobs", "1")
    assert (tmp_path / "out" / "scene.gsyn").read_bytes() == (done / "scene.gsyn").read_bytes()


def test_what_a_kill_left_after_the_last_step_is_finished(
    town: Path, done: Path, tmp_path: Path
) -> None:
    """The whole without its file, a block with its lock and the full model it began from."""
    out = tmp_path / "out"
    for name in (WHOLE, BLOCKS):
        shutil.copytree(done / name, out / name)
    before = {path.relative_to(out) for path in out.rglob("*")}
    (out / WHOLE / "scene.gsyn").unlink()
    for name in ("training.lock", "full.safetensors"):
        (out / BLOCKS / "0001" / name).touch()
    assert main(command(town, out, "--jobs", "1")) == 0
    after = {path.relative_to(out) for path in out.rglob("*")}
    assert {path for path in after if path.parts[0] in (WHOLE, BLOCKS)} == before
    for name in ("scene.gsyn", f"{WHOLE}/scene.gsyn"):
        assert (out / name).read_bytes() == (done / name).read_bytes()


@pytest.mark.slow
def test_ray_gives_the_same_file_also_when_a_worker_is_killed(
    town: Path, done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("ray")
    monkeypatch.setenv("RAY_memory_monitor_refresh_ms", "0")
    killed(town, done, tmp_path / "out", "--ray", "local")
    assert (tmp_path / "out" / "scene.gsyn").read_bytes() == (done / "scene.gsyn").read_bytes()


def test_a_block_that_fails_is_named_and_the_others_are_kept(
    town: Path, done: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    shutil.copytree(done / WHOLE, out / WHOLE)
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


def test_a_division_needs_two_blocks() -> None:
    with pytest.raises(SettingError, match="2 to 1,000"):
        Division(1)
