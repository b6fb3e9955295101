"""What a training is said to take, against what it takes."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from gsynopsis.config import Config, preset_of
from gsynopsis.resources.estimate import (
    DECODED_BYTES,
    DECODING_BYTES,
    anchor_bytes,
    free_memory,
    held_photos,
    make_plan,
    most_anchors,
    needed_bytes,
    peak_bytes,
    row_values,
)
from gsynopsis.training.distributed.process_group import ProcessGroup
from gsynopsis.training.optim.param_groups import shared_parameters
from gsynopsis.training.regularize.jitter import photo_bytes
from tests.tiny import half_size, tiny_config, tiny_model, tiny_scene

CPU = torch.device("cpu")
ROOT = Path(__file__).parents[2]
CHILD = """
import json, re, sys, torch
from pathlib import Path
from dataclasses import replace
from gsynopsis.render.choose import make_renderer
from gsynopsis.resources.estimate import make_plan
from gsynopsis.training.observer import Silent
from gsynopsis.training.loop import open_state, run_training
from gsynopsis.training.context import TrainContext
from gsynopsis.training.distributed.process_group import ProcessGroup
from tests.tiny import tiny_scene
from tests.resources.test_estimate import measured_config

torch.set_num_threads(1)
scene, config = tiny_scene(size=(160, 120), points=20000), measured_config()
plan = make_plan(scene, config, torch.device("cpu"), ProcessGroup())
context, out = TrainContext(scene, config, make_renderer("cpu")), Path(sys.argv[1])
run_training(open_state(context, out, Silent()), out, Silent(), bool)
peak = re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())
print(json.dumps([plan.anchors, plan.start_bytes, int(peak[1]) * 1024]))
"""


def measured_config() -> Config:
    """Our model, a few steps of both phases, one adjustment that adds nothing."""
    config = preset_of("max").config
    growth = replace(config.train.growth, until=1, every=2, threshold=1e9)
    train = replace(config.train, steps=4, growth=growth)
    return replace(config, train=train, levels=replace(config.levels, steps=2))


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="no /proc to read memory from")
def test_memory_is_foreseen_within_a_third_and_its_growth_within_a_half(tmp_path: Path) -> None:
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    line = [sys.executable, "-c", CHILD, str(tmp_path)]
    done = subprocess.run(line, capture_output=True, text=True, env=environment, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    anchors, planned, peak = json.loads(done.stdout)
    assert anchors > 15_000
    assert 3 / 4 < planned / peak < 4 / 3
    empty = peak_bytes(tiny_scene(size=(160, 120)), measured_config(), 0, CPU)
    assert 2 / 3 < (planned - empty) / (peak - empty) < 3 / 2


def test_the_plan_counts_what_the_training_will_have() -> None:
    scene, config = tiny_scene(), tiny_config()
    plan = make_plan(scene, config, CPU, ProcessGroup())
    model = tiny_model(config.model)
    assert plan.anchors == len(model) and plan.photos == len(scene.train)
    assert (plan.width, plan.height, plan.steps) == (24, 16, 50)
    rows = [p for n, p in shared_parameters(model).items() if n != "table"]
    assert row_values(config.model) == sum(p[0].numel() for p in rows)
    assert plan.max_anchors == 1_000_000 and plan.most_bytes > 100 * anchor_bytes(config)


def test_a_limit_holds_as_many_anchors_as_need_it() -> None:
    scene, config = tiny_scene(), tiny_config()
    for anchors in (1, 500, 70_000):
        need = needed_bytes(scene, config, anchors, CPU)
        assert abs(most_anchors(need, scene, config, CPU) - anchors) <= 1
    assert most_anchors(1 << 20, scene, config, CPU) == 0


def test_batches_and_wider_rows_cost_more_and_a_gpu_holds_no_process() -> None:
    scene, config = tiny_scene(), tiny_config()
    wide = replace(config, model=replace(config.model, codebook=256))
    two = replace(config, train=replace(config.train, batch=2))
    assert anchor_bytes(wide) > anchor_bytes(config) < anchor_bytes(two)
    free = replace(config, model=replace(config.model, feature="free"))
    assert row_values(free.model) == 3 * 3 + 6 + 32
    on_gpu = peak_bytes(scene, config, 100, torch.device("cuda"))
    assert 0 < on_gpu < peak_bytes(scene, config, 100, CPU)


def test_photos_of_four_places_cost_four_times_as_much_where_they_are_taken() -> None:
    scene, config = tiny_scene(), tiny_config()
    half = replace(config, scale=2.0)
    photos = 3 * 12 * 8 * len(scene.train)
    for usual, more in ((config, 0), (half, 3 * photos)):
        jittered = replace(usual, train=replace(usual.train, subpixel_jitter=2))
        taken = peak_bytes(scene, jittered, 9, CPU) - peak_bytes(scene, usual, 9, CPU)
        assert taken == more


def test_free_memory_is_a_size_or_unknown() -> None:
    free = free_memory(CPU)
    assert free is None or 2**20 < free < 2**60


def test_photos_that_do_not_fit_count_as_what_decoding_takes() -> None:
    scene, config = tiny_scene(), half_size(tiny_config())
    photos = photo_bytes(scene, config)
    scene.cache.budget = photos
    once = photos + DECODED_BYTES * 24 * 16
    assert held_photos(scene, config) == once
    reduced = replace(config, train=replace(config.train, reduced_until=(0.3, 0.6)))
    assert held_photos(scene, reduced) == once  # smaller ones go where there is no room
    scene.cache.budget = 2 * photos
    assert held_photos(scene, reduced) == once + photos * 5 // 16
    scene.cache.budget = photos
    whole = peak_bytes(scene, config, 100, CPU)
    scene.cache.budget = photos - 1
    assert held_photos(scene, config) == DECODING_BYTES * 24 * 16
    assert peak_bytes(scene, config, 100, CPU) - whole == DECODING_BYTES * 24 * 16 - once
