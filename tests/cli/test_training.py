"""The training commands as a person runs them: real processes, real files."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from gsynopsis.cli import parse
from gsynopsis.cli.orbit import FIRST
from gsynopsis.cli.settings import (
    Overrides,
    apply_overrides,
    build_config,
    config_from_dict,
)
from gsynopsis.cli.suit import (
    FEW_VIEWS,
    FINE_PASSES,
    FINE_POWER,
    GROWING_STEPS,
    PASS_POWER,
    PASSES,
    SHORTEST,
    for_few_views,
    for_short_growth,
    for_views,
)
from gsynopsis.cli.train import Train
from gsynopsis.config import PRESETS, preset, total_steps
from gsynopsis.model.focals import parse_focals
from gsynopsis.pack import describe, read_gsyn
from gsynopsis.pack.gains import parse_gains
from gsynopsis.pack.poster import parse_poster
from gsynopsis.render.base import focal_length
from gsynopsis.scene.scene import load_scene
from gsynopsis.scene.synthetic import make_scene

SMALL = ("--set", "model.table_log2=8", "--set", "model.codebook=8", "--set", "model.slots=4")


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("scenes") / "room"
    return make_scene("room", out, views=9, width=48, height=32, points=300)


def command(*words: str | Path, file_limit: int | None = None) -> subprocess.CompletedProcess[str]:
    """A process; with a limit no file that it writes gets longer than so many bytes."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    line = [sys.executable, "-m", "gsynopsis", *map(str, words)]
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
    line = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", "-m"]
    line += ["gsynopsis", "train", str(room), "--out", str(two), *words]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, *line], capture_output=True, text=True, env=environment, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert (two / "scene.gsyn").read_bytes() == (one / "scene.gsyn").read_bytes()
    assert done.stderr.count("full 1/12") == 1 and done.stderr.count("wrote") == 1


def test_a_disk_that_fills_up_keeps_the_last_checkpoint(room: Path, tmp_path: Path) -> None:
    """A real one: the system lets no file grow beyond the limit, as with `ulimit -f`."""
    run = tmp_path / "run"
    words = ("train", room, "--out", run, "--steps", "4", "--no-evaluate", *SMALL)
    often = ("--set", "train.checkpoint_seconds=0.0")
    first = command(*words, *often)
    assert first.returncode == 0, first.stderr
    checkpoint = run / "checkpoint.safetensors"
    shutil.copyfile(run / "full.safetensors", checkpoint)
    before, size = checkpoint.read_bytes(), checkpoint.stat().st_size
    full = command(*words, *often, file_limit=size // 2)
    assert full.returncode == 2 and "Traceback" not in full.stderr
    (line,) = [text for text in full.stderr.splitlines() if text.startswith("gsynopsis: ")]
    assert f"{checkpoint}: checkpoint: found " in line and "File too large" in line
    assert checkpoint.read_bytes() == before and not list(run.glob("*.tmp"))


def test_a_training_that_diverges_ends_with_one_line(room: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    words = ("--steps", "40", "--no-evaluate", "--set", "train.volume_weight=1e39", *SMALL)
    done = command("train", room, "--out", run, *words)
    assert done.returncode == 1 and "Traceback" not in done.stderr
    line = done.stderr.splitlines()[-1]
    assert re.search(r"gsynopsis: step \d+: view \S+ gives a loss of inf .*; the last", line), line


def test_unfold_makes_other_levels_from_the_same_full_model(room: Path, tmp_path: Path) -> None:
    run, other = tmp_path / "run", tmp_path / "other"
    assert command("train", room, "--out", run, "--steps", "20", "--no-evaluate", *SMALL)
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
    expected = [focal_length(camera) for camera in cameras]
    assert lengths == [(min(expected), max(expected))] * 4
    assert own is not None
    assert [high / own[3][1] for _, high in own] == pytest.approx([1 / 8, 1 / 4, 1 / 2, 1], rel=0.1)
    assert own[3] == lengths[3]
    # And where the first look is from: one of them.
    first = np.reshape(json.loads(joint.meta[FIRST])["w2c"], (3, 4))
    assert any(np.allclose(first, camera.w2c[:3], atol=1e-5) for camera in cameras)
    record = json.loads((other / "run.json").read_text())
    assert record["config"]["levels"]["mode"] == "sequential"
    refused = command("unfold", run, "--out", tmp_path / "x", "--feature", "free")
    assert refused.returncode == 2 and "full model" in refused.stderr


def test_pack_writes_the_same_file_again_and_a_raw_one(room: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert command("train", room, "--out", run, "--steps", "20", "--no-evaluate", *SMALL)
    for coding in ("compact", "raw"):
        out = tmp_path / f"{coding}.gsyn"
        assert command("pack", run, "--out", out, "--coding", coding).returncode == 0
    assert (tmp_path / "compact.gsyn").read_bytes() == (run / "scene.gsyn").read_bytes()
    assert read_gsyn(tmp_path / "raw.gsyn").levels[3].anchors > 0
    assert command("pack", run, "--block", "1").returncode == 2


def test_evaluate_notes_what_the_blocks_of_a_file_add(room: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert command("train", room, "--out", run, "--steps", "20", "--no-evaluate", *SMALL)
    assert command("pack", run, "--block", "64").returncode == 0
    blocks = [level.blocks for level in describe(run / "scene.gsyn").levels]
    assert blocks[-1] > 1
    done = command("evaluate", run, "--frames", "1", "--popping", "--json")
    assert done.returncode == 0
    assert [switch["level"] for switch in json.loads(done.stdout)["popping"]] == [1, 2, 3]
    gains = parse_gains(describe(run / "scene.gsyn").meta["gains"], blocks[1:])
    assert gains is not None
    assert sum(float(level.sum()) for level in gains) > 0


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--scale", "0.5"), "--scale: found 0.5, expected 1 to 65,536"),
        (("--steps", "0"), "--steps: found 0, expected 1 to 100,000,000"),
        (("--batch", "0"), "--batch: found 0, expected 1 to 1,024"),
        (
            ("--set", "levels.weights=[0.5, 0]"),
            "levels.weights: found (0.5, 0.0), expected 0 to 16 numbers, each above 0",
        ),
        (("--set", "levels.faint_share=1"), "levels.faint_share: found 1.0, expected 0 to below 1"),
        (("--set", "train.subpixels=0"), "train.subpixels: found 0, expected 1 to 8"),
        (("--set", "model.grids=4"), "levels.networks: found common, expected own, or levels.grid"),
        (("--set", "model.opacity_spread=0"), "model.opacity_spread: found 0.0, expected above 0"),
        (("--keep", "0.5", "1.5"), "--keep: found"),
        (("--set", "model.tables=3"), "model.tables: found no such setting"),
        (("--set", "model.table_log2=many"), "model.table_log2: found 'many'"),
        (("--set", "seed"), "--set: found seed, expected name=value"),
    ],
)
def test_settings_that_cannot_be_are_one_line_and_exit_2(
    room: Path, tmp_path: Path, words: tuple[str, ...], expected: str
) -> None:
    done = command("train", room, "--out", tmp_path / "run", *words)
    assert done.returncode == 2 and expected in done.stderr
    assert len(done.stderr.splitlines()) == 1 and not (tmp_path / "run").exists()


def test_a_run_of_another_scene_is_refused(room: Path, tmp_path: Path) -> None:
    other = make_scene("room", tmp_path / "o", views=9, width=48, height=32, points=300, seed=1)
    out = tmp_path / "run"
    words = ("--steps", "5", "--no-evaluate", *SMALL)
    assert command("train", room, "--out", out, *words).returncode == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    done = command("train", other, "--out", out, *words)
    assert done.returncode == 2 and "another scene" in done.stderr
    done = command("train", room, "--out", out, *words, "--seed", "7")
    assert done.returncode == 2 and "train.seed: found 0, expected 7" in done.stderr
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


@pytest.mark.parametrize("name", list(PRESETS))
def test_a_recorded_config_comes_back_unchanged(name: str) -> None:
    config = preset(name)
    record = json.loads(json.dumps(asdict(config)))
    assert config_from_dict(preset("paper"), record) == config


def test_settings_may_follow_one_set_or_several() -> None:
    words = ["train", "scene", "--out", "run", "--set", "model.slots=4", "model.hidden=32"]
    command = parse([*words, "--set", "model.codebook=8"])
    assert isinstance(command, Train)
    model = apply_overrides(preset("fast"), command.overrides).model
    assert (model.slots, model.hidden, model.codebook) == (4, 32, 8)


def test_a_number_may_be_written_without_its_zero() -> None:
    given = Overrides(set=(("train.average=.25", "levels.spread=1."),))
    config = apply_overrides(preset("fast"), given)
    assert (config.train.average, config.levels.spread) == (0.25, 1.0)


@pytest.mark.parametrize("name", ["fast", "ours"])
def test_few_views_change_what_the_user_did_not(name: str) -> None:
    config = preset(name)
    few = for_few_views(config, FEW_VIEWS - 1)
    assert for_few_views(config, FEW_VIEWS) == config != few
    assert (few.model.opacity_spread, few.train.growth.threshold) == (2.0, 2e-4)
    assert (config.model.slots, few.model.slots, few.model.init_factor) == (16, 10, 16)
    assert not few.levels.always_finest and for_few_views(few, 1) == few, "a recorded run goes on"
    assert (config.levels.networks, few.levels.networks) == ("common", "own")
    words = ("model.opacity_spread=5", "train.growth.threshold=0.001", "levels.always_finest=false")
    rest = ("levels.networks=own", "model.init_factor=32", "model.slots=8")
    own = apply_overrides(config, Overrides(set=((*words, *rest),)))
    assert for_few_views(own, 1) == own
    assert for_few_views(preset("paper"), 1) == preset("paper")


@pytest.mark.parametrize("name", ["fast", "ours"])
def test_values_are_rounded_less_where_photos_are_seen_often(name: str) -> None:
    config, usual = preset(name), preset(name).levels.coding_loss
    often = replace(config, train=replace(config.train, steps=FINE_PASSES * FEW_VIEWS))
    often = replace(often, levels=replace(often.levels, steps=FINE_PASSES * FEW_VIEWS))
    assert for_views(often, 2 * FEW_VIEWS).levels.coding_loss == usual
    for views in (FEW_VIEWS, 3):
        fine = for_views(often, views)
        assert fine.levels.coding_loss == pytest.approx(usual / 2**FINE_POWER)
        assert for_views(fine, views) == fine, "a recorded run goes on"
    own = apply_overrides(often, Overrides(set=(("levels.coding_loss=0.2",),)))
    assert for_views(own, FEW_VIEWS).levels.coding_loss == 0.2


@pytest.mark.parametrize("name", ["fast", "ours"])
def test_less_may_go_of_levels_that_see_the_photos_seldom(name: str) -> None:
    config, usual = preset(name), preset(name).levels.faint_share
    seen = total_steps(config) / PASSES
    once = for_views(config, round(4 * seen))
    assert once.levels.faint_share == pytest.approx(usual * 0.25**PASS_POWER, rel=0.01)
    batch = for_views(build_config(name, 1.0, "every8", Overrides(batch=4)), round(4 * seen))
    assert batch.levels.faint_share == pytest.approx(usual, rel=0.01)
    assert for_views(config, FEW_VIEWS).levels.faint_share == usual
    assert for_views(config, 1).levels.faint_share == usual
    short = build_config(name, 1.0, "every8", Overrides(steps=config.train.steps // 20))
    few = usual * (total_steps(short) / FEW_VIEWS / PASSES) ** PASS_POWER
    for views in (1, FEW_VIEWS // 2):
        assert for_views(short, views).levels.faint_share == pytest.approx(min(usual, few))
    assert for_views(once, 1).levels.faint_share == once.levels.faint_share, (
        "a recorded run goes on"
    )
    own = apply_overrides(config, Overrides(set=(("levels.faint_share=0.25",),)))
    assert for_views(own, round(4 * seen)) == own
    assert for_views(preset("paper"), 1) == preset("paper")


def test_short_trainings_grow_faster_and_keep_less_of_it() -> None:
    config, growth = preset("fast"), preset("fast").train.growth
    assert for_short_growth(config) == config
    short = build_config("fast", 1.0, "every8", Overrides(steps=round(0.6 * GROWING_STEPS)))
    faster = for_views(short, FEW_VIEWS)
    assert faster.train.growth.threshold == pytest.approx(0.6 * growth.threshold)
    assert faster.levels.faint_share == pytest.approx(config.levels.faint_share / 0.6)
    assert for_views(faster, FEW_VIEWS) == faster, "a recorded run goes on"
    shortest = build_config("fast", 1.0, "every8", Overrides(steps=3))
    assert for_short_growth(shortest).train.growth.threshold == SHORTEST * growth.threshold
    few = for_views(short, FEW_VIEWS - 1)
    assert few.train.growth.threshold == 2e-4
    assert few.levels.faint_share == config.levels.faint_share
    own = apply_overrides(short, Overrides(set=(("train.growth.threshold=0.001",),)))
    assert for_short_growth(own) == own
    paper = replace(preset("paper"), train=replace(preset("paper").train, steps=1))
    assert for_views(paper, FEW_VIEWS) == paper


def test_training_with_few_views_says_so_and_records_what_it_used(
    room: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    done = command("train", room, "--out", out, "--preset", "fast", "--steps", "2", "--no-evaluate")
    assert done.returncode == 0 and "training views are few" in done.stdout + done.stderr
    spread = json.loads((out / "run.json").read_text())["config"]["model"]["opacity_spread"]
    assert spread == 2.0


def test_steps_scale_the_levels_along() -> None:
    config = build_config("paper", 2.0, "every8", Overrides(steps=3000))
    assert (config.train.steps, config.levels.steps, config.scale) == (3000, 1000, 2.0)


def test_any_number_of_levels_can_be_asked_for() -> None:
    config = apply_overrides(preset("fast"), Overrides(keep=(0.5, 0.5)))
    assert config.levels.count == 3
