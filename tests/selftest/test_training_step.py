"""A step beside the CPU's: the same device has no error, a wrong one is found, times have parts."""

import pytest
import torch

from gsynopsis.config import resolve_settings
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.selftest.training_step import check_step, time_step, trained_state, twin_of
from gsynopsis.training.state import TrainState
from tests.selftest.smeared import Smeared
from tests.tiny import tiny_scene


@pytest.fixture(scope="module")
def trained() -> TrainState:
    scene = tiny_scene(size=(48, 32))
    config = resolve_settings("standard", len(scene.train), {"train.steps": 40}).config
    return trained_state(scene, config, CpuRenderer(), 20)


def test_a_step_of_the_same_device_is_the_same_and_of_a_wrong_one_is_not(
    trained: TrainState,
) -> None:
    same = check_step("same", trained, twin_of(trained, CpuRenderer()))
    assert not same.failed and max(same.errors.values()) < 1e-6
    assert {"residual.gradient", "visits.statistics", "loss", "image"} <= same.errors.keys()
    wrong = check_step("wrong", twin_of(trained, Smeared()), trained)
    assert {"image", "offsets.gradient", "drawn.statistics"} <= set(wrong.failed)


def test_times_of_all_parts_are_told_and_the_model_moves_on(trained: TrainState) -> None:
    state = twin_of(trained, CpuRenderer())
    before = state.model.offsets.detach().clone()
    times = time_step(state, 2)
    assert times.anchors == len(state.model) and times.gaussians > 0 and times.memory == 0
    assert list(times.parts) == [
        *("photo", "culling, heads, assembly", "rasterizer", "loss", "loss, backward"),
        *("rasterizer, backward", "heads, assembly, backward", "growth statistics", "Adam"),
    ]
    assert times.whole > 0 and min(times.parts.values()) >= 0
    assert not torch.equal(before, state.model.offsets)
