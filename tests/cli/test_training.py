"""The training commands as a person runs them, on real files.

Where signals, limits or several processes are the subject they are processes of their own.
"""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gsynopsis import cli
from gsynopsis.container import describe, read_gsyn
from gsynopsis.container.notes.block_utility import parse_utility
from gsynopsis.container.notes.poster import parse_poster
from gsynopsis.model.training_focals import parse_focals
from gsynopsis.records import FIRST_NOTE, UTILITY_NOTE
from gsynopsis.scene.load import load_scene
from gsynopsis.synthetic.make_scene import make_scene
from gsynopsis.training import view_step
from tests.commands import command

SMALL = ("--set", "model.table_log2=8", "--set", "model.codebook=8", "--set", "model.slots=4")


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("scenes") / "room"
    return make_scene("room", out, views=9, width=48, height=32, points=300)


@pytest.fixture(scope="module")
def trained(room: Path) -> Path:
    """A run of twenty steps that no test changes."""
    run = room.parent / "trained"
    words = ("--steps", "20", "--no-evaluate", *SMALL)
    done = command("train", room, "--out", run, *words)
    assert done.returncode == 0, done.stderr
    return run


def process(
    *words: str | Path, module: str = "gsynopsis", file_limit: int | None = None
) -> subprocess.CompletedProcess[str]:
    """A process; with a limit no file that it writes gets longer than so many bytes."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    line = [sys.executable, "-m", module, *map(str, words)]
    if file_limit is not None:
        limit = f"import resource as r; r.setrlimit(r.RLIMIT_FSIZE, ({file_limit}, {file_limit}))"
        start = f"{limit}; from gsynopsis.cli import main; raise SystemExit(main())"
        line[1:3] = ["-c", start]
    return subprocess.run(line, capture_output=True, text=True, env=environment, timeout=300)


def test_train_writes_the_file_the_metrics_and_the_pictures(room: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    done = command("train", room, "--out", out, "--steps", "30", "--json", *SMALL)
    assert done.returncode == 0, done.stderr
    printed = json.loads(done.stdout)
    assert printed == json.loads((out / "metrics.json").read_text())
    assert [row["level"] for row in printed["levels"]] == [0, 1, 2, 3]
    sizes = [row["bytes_compact"] for row in printed["levels"]]
    assert sizes == sorted(sizes) and sizes[-1] == (out / "scene.gsyn").stat().st_size
    packed = read_gsyn(out / "scene.gsyn")
    assert parse_poster(packed.meta["poster"])
    quality = packed.levels[3].quality
    assert quality["psnr_full"] == pytest.approx(printed["levels"][3]["psnr_full"], abs=1e-4)
    assert sum(row["delta_compact"] for row in printed["levels"]) == sizes[-1]
    assert printed["steps"] == 80 and printed["train_seconds"] > 0
    for name in ("contact.png", "report.html", "metrics.csv", "checkpoint.safetensors"):
        assert (out / name).stat().st_size > 0


@pytest.mark.usefixtures("interruptible")
def test_an_interrupted_run_goes_on_to_the_same_bytes(room: Path, tmp_path: Path) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    options = ("--steps", "60", "--no-evaluate", *SMALL)
    assert command("train", room, "--out", whole, *options).returncode == 0
    line = [sys.executable, "-m", "gsynopsis", "train", str(room), "--out", str(parts), *options]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    with subprocess.Popen(line, stderr=subprocess.PIPE, text=True, env=environment) as child:
        assert child.stderr is not None
        assert any("full 1/60" in line for line in iter(child.stderr.readline, ""))
        child.send_signal(signal.SIGINT)
        rest = child.stderr.read()
        assert child.wait(timeout=60) == 130
    assert re.search(r"stopped at full \d+/60; saved", rest) and "Traceback" not in rest
    assert not (parts / "scene.gsyn").exists()
    again = command("train", room, "--out", parts, *options)
    assert again.returncode == 0 and "resuming at full" in again.stderr
    assert (parts / "scene.gsyn").read_bytes() == (whole / "scene.gsyn").read_bytes()


def test_more_steps_on_a_finished_run_go_on_from_its_full_model(room: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    words = ("train", room, "--out", run, "--no-evaluate", *SMALL)
    assert command(*words, "--steps", "6").returncode == 0
    more = command(*words, "--steps", "9")
    assert more.returncode == 0, more.stderr
    assert "more steps: the full model's 6 are kept, 3 more follow" in more.stderr
    assert "9 steps full + 15 joint = 24" in more.stderr and "full 7/9" in more.stderr
    fewer = command(*words, "--steps", "6")
    assert fewer.returncode == 2 and "train.steps: found" in fewer.stderr


def test_torchrun_trains_the_same_file_as_one_process(room: Path, tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    words = ("--batch", "2", "--steps", "12", "--no-evaluate", *SMALL)
    assert command("train", room, "--out", one, *words).returncode == 0
    line = ("--standalone", "--nproc-per-node", "2", "-m", "gsynopsis", "train", room)
    done = process(*line, "--out", two, *words, module="torch.distributed.run")
    assert done.returncode == 0, done.stderr
    assert (two / "scene.gsyn").read_bytes() == (one / "scene.gsyn").read_bytes()
    assert done.stderr.count("full 1/12") == 1 and done.stderr.count("wrote") == 1


def test_a_disk_that_fills_up_keeps_the_last_checkpoint(room: Path, tmp_path: Path) -> None:
    """A real one: the system lets no file grow beyond the limit, as with `ulimit -f`."""
    run = tmp_path / "run"
    words = ("train", room, "--out", run, "--steps", "4", "--no-evaluate", *SMALL)
    often = ("--checkpoint-seconds", "0")
    first = command(*words, *often)
    assert first.returncode == 0, first.stderr
    checkpoint = run / "checkpoint.safetensors"
    shutil.copyfile(run / "full.safetensors", checkpoint)
    before, size = checkpoint.read_bytes(), checkpoint.stat().st_size
    full = process(*words, *often, file_limit=size // 2)
    assert full.returncode == 2 and "Traceback" not in full.stderr
    (line,) = [text for text in full.stderr.splitlines() if text.startswith("gsynopsis: ")]
    assert f"{checkpoint}: checkpoint: found " in line and "File too large" in line
    assert checkpoint.read_bytes() == before and not list(run.glob("*.tmp"))


def test_a_training_that_diverges_ends_with_one_line(
    room: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(view_step, "VOLUME_WEIGHT", 1e39)
    words = ("--steps", "40", "--no-evaluate", *SMALL)
    assert cli.main(["train", str(room), "--out", str(tmp_path / "run"), *words]) == 1
    line = capsys.readouterr().err.splitlines()[-1]
    assert re.search(r"gsynopsis: step \d+: view \S+ gives a loss of inf .*; the last", line), line


def test_unfold_makes_other_levels_from_the_same_full_model(
    room: Path, trained: Path, tmp_path: Path
) -> None:
    run, other = trained, tmp_path / "other"
    words = ("--levels", "sequential", "--steps", "8", "--no-evaluate")
    done = command("unfold", run, "--out", other, *words)
    assert done.returncode == 0, done.stderr
    joint, sequential = read_gsyn(run / "scene.gsyn"), read_gsyn(other / "scene.gsyn")
    assert len(joint.levels) == len(sequential.levels) == 4
    # Files say how large the photos were: the same for joint levels, halved for each coarser one.
    lengths, own = (parse_focals(s.meta["focals"], 4) for s in (joint, sequential))
    scene = load_scene(room, "every8")
    scale = json.loads((run / "run.json").read_text())["scale"]
    cameras = [scene.camera(view, scale) for view in scene.train]
    expected = [camera.focal_length for camera in cameras]
    assert lengths == [(min(expected), max(expected))] * 4
    assert own is not None
    assert [high / own[3][1] for _, high in own] == pytest.approx([1 / 8, 1 / 4, 1 / 2, 1], rel=0.1)
    assert own[3] == lengths[3]
    # And where the first look is from: one of them.
    first = np.reshape(json.loads(joint.meta[FIRST_NOTE])["w2c"], (3, 4))
    assert any(np.allclose(first, camera.w2c[:3], atol=1e-5) for camera in cameras)
    record = json.loads((other / "run.json").read_text())
    assert record["config"]["levels"]["mode"] == "sequential"
    refused = command("unfold", run, "--out", tmp_path / "x", "--feature", "free")
    assert refused.returncode == 2 and "full model" in refused.stderr


def test_pack_writes_the_same_file_again_and_a_raw_one(trained: Path, tmp_path: Path) -> None:
    run = trained
    for coding in ("compact", "raw"):
        out = tmp_path / f"{coding}.gsyn"
        assert command("pack", run, "--out", out, "--coding", coding).returncode == 0
    assert (tmp_path / "compact.gsyn").read_bytes() == (run / "scene.gsyn").read_bytes()
    assert read_gsyn(tmp_path / "raw.gsyn").levels[3].anchors > 0
    assert command("pack", run, "--block", "1").returncode == 2


def test_quality_and_blocks_are_in_the_file_and_evaluate_changes_nothing(
    trained: Path, tmp_path: Path
) -> None:
    # Beside the other: the record names the scene as seen from the run.
    run = Path(shutil.copytree(trained, trained.with_name("in_blocks")))
    assert command("pack", run, "--block", "64").returncode == 0
    info = describe(run / "scene.gsyn")
    assert info.levels[-1].blocks > 1
    assert [sorted(level.quality) for level in info.levels] == [
        ["flip_full", "flip_own", "psnr_full", "psnr_own", "ssim_full", "ssim_own"]
    ] * 4
    utilities = parse_utility(info.meta[UTILITY_NOTE], [level.blocks for level in info.levels[1:]])
    assert utilities is not None
    assert sum(float(level.sum()) for level in utilities) > 0
    before = {path.name: path.read_bytes() for path in run.iterdir()}
    done = command("evaluate", run, "--frames", "1", "--popping", "--json")
    assert done.returncode == 0
    printed = json.loads(done.stdout)
    assert [switch["level"] for switch in printed["popping"]] == [1, 2, 3]
    for row, level in zip(printed["levels"], info.levels, strict=True):
        assert row["psnr_full"] == pytest.approx(level.quality["psnr_full"], abs=1e-4)
    assert before.items() <= {p.name: p.read_bytes() for p in run.iterdir()}.items()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--scale", "0.5"), "--scale: found 0.5, expected float >= 1.0"),
        (("--steps", "0"), "--steps: found 0, expected int >= 1"),
        (("--batch", "0"), "--batch: found 0, expected int >= 1"),
        (("--levels.loss-weights", "0.5", "0"), "--levels.loss_weights: found "),
        (("--set", "levels.prune_share=1"), "--levels.prune_share: found 1, expected float < 1.0"),
        (("--train.subpixel-jitter", "0"), "--train.subpixel_jitter: found 0, expected int >= 1"),
        (("--model.opacity-init-scale", "0"), "found 0.0, expected float > 0.0"),
        (("--keep", "0.5", "1.5"), "--keep: found"),
        (("--levels", "foo"), "--levels: found 'foo', expected joint or sequential"),
        (("--levels.sparsity", "1"), "it is a setting of sequential levels"),
        (("--set", "model.tables=3"), "--model.tables: found no such setting"),
        (("--set", "model.table_log2=many"), "--model.table_log2: found 'many', expected int"),
        (("--max-memory", "0.1"), "--max-memory: found 0.1 GiB, expected at least 0."),
        (("--set", "seed"), "--set: found seed, expected name=value"),
    ],
)
def test_settings_that_cannot_be_are_one_line_and_exit_2(
    room: Path, tmp_path: Path, words: tuple[str, ...], expected: str
) -> None:
    done = command("train", room, "--out", tmp_path / "run", *words)
    assert done.returncode == 2 and expected in done.stderr
    assert len(done.stderr.splitlines()) == 1 and not (tmp_path / "run").exists()


def test_a_run_of_another_scene_is_refused(room: Path, trained: Path, tmp_path: Path) -> None:
    other = make_scene("room", tmp_path / "o", views=9, width=48, height=32, points=300, seed=1)
    words = ("--steps", "20", "--no-evaluate", *SMALL)
    before = {path.name: path.read_bytes() for path in trained.iterdir()}
    done = command("train", other, "--out", trained, *words)
    assert done.returncode == 2 and "another scene" in done.stderr
    done = command("train", room, "--out", trained, *words, "--seed", "7")
    assert done.returncode == 2 and "train.seed: found 0, expected 7" in done.stderr
    assert {path.name: path.read_bytes() for path in trained.iterdir()} == before


def test_training_with_few_views_says_so_and_records_what_it_used(
    room: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    done = command(
        "train", room, "--out", out, "--preset", "standard", "--steps", "2", "--no-evaluate"
    )
    assert done.returncode == 0, done.stderr
    assert "settings: train.growth.threshold 0.0002: 7 photos, 5 steps" in done.stderr
    record = json.loads((out / "run.json").read_text())
    assert record["config"]["model"]["opacity_init_scale"] == 2.0
    assert record["followed"]["model.slots"] == "7 photos, 5 steps"
    assert record["asked"] == ["scale", "split", "train.steps"]
