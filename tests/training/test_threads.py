"""Whole short trainings give the same bytes for any number of threads."""

import hashlib
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from gsynopsis.config import Config
from gsynopsis.container import encode
from gsynopsis.jobs.write_file import FilePacker
from gsynopsis.model.build import model_to_levels
from gsynopsis.render.choose import make_renderer
from gsynopsis.training.context import TrainContext
from gsynopsis.training.loop import open_state, run_training
from gsynopsis.training.observer import Silent
from tests.tiny import tiny_config, tiny_scene


def longer(config: Config) -> Config:
    """Enough anchors for several tasks of every kernel."""
    growth = replace(config.train.growth, until=0.0)
    return replace(
        config,
        model=replace(config.model, voxel=0.02),
        train=replace(config.train, steps=6, weight_average=0.5, growth=growth),
    )


def trained(config: Config, threads: int, out: Path) -> str:
    scene = tiny_scene(size=(96, 64), points=1500)
    context = TrainContext(scene, config, make_renderer("cpu"), FilePacker())
    torch.set_num_threads(threads)
    out.mkdir()
    state = open_state(context, out, Silent())
    assert run_training(state, out, Silent(), lambda: False)
    assert torch.get_num_threads() == threads
    assert len(state.model) > 1024
    return hashlib.sha256(encode(model_to_levels(state.model, {}), "raw")).hexdigest()


@pytest.mark.parametrize(
    "config",
    [
        tiny_config(steps=6, coding_loss=0.05, weights="tied"),
        tiny_config(mode="sequential", steps=4),
    ],
    ids=["joint", "sequential"],
)
def test_any_number_of_threads_gives_the_same_bytes(config: Config, tmp_path: Path) -> None:
    before = torch.get_num_threads()
    try:
        found = {trained(longer(config), n, tmp_path / str(n)) for n in (1, 2, 4)}
    finally:
        torch.set_num_threads(before)
    assert len(found) == 1
