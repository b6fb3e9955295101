"""All levels in each few steps: which ones, by what weight, and their ranks."""

from itertools import pairwise
from pathlib import Path

import pytest
import torch

from gsynopsis.config import Joint
from gsynopsis.render.choose import make_renderer
from gsynopsis.training.context import TrainContext
from gsynopsis.training.loop import open_state, run_training
from gsynopsis.training.observer import Silent, StepInfo
from gsynopsis.training.phases.joint import JointPhase
from gsynopsis.training.state import TrainState, fresh_state, set_optimizer
from tests.tiny import tiny_config, tiny_scene


def begun(**levels: object) -> tuple[JointPhase, TrainState]:
    config = tiny_config(**levels)
    assert isinstance(config.levels, Joint)
    state = fresh_state(TrainContext(tiny_scene(), config, make_renderer("cpu")))
    phase = JointPhase(config.levels, 0)
    phase.begin(state)
    set_optimizer(state, phase.make_optimizer(state))
    return phase, state


@pytest.mark.parametrize(("wanted", "mean"), [(2, 2.0), (2.5, 2.5), (9, 4.0)])
def test_the_finest_level_is_in_every_step_and_others_by_chance(wanted: float, mean: float) -> None:
    phase, state = begun(levels_per_step=wanted)
    drawn = [phase._drawn(state) for _ in range(400)]
    assert all(levels[-1] == 3 and len(set(levels)) == len(levels) for levels in drawn)
    assert sum(map(len, drawn)) / 400 == pytest.approx(mean, abs=0.1)
    assert {level for levels in drawn for level in levels} == {0, 1, 2, 3}


def test_levels_weigh_what_was_asked_and_the_finest_one() -> None:
    phase, _ = begun(loss_weights=(2.0, 0.5))
    assert [phase._weight(level, 4) for level in range(4)] == [2.0, 0.5, 1.0, 1.0]


def test_levels_begin_nested_with_heads_of_their_own() -> None:
    _, state = begun()
    parts = state.model.level_parts()
    assert len(parts) == 4
    for coarse, fine in pairwise(parts):
        assert not bool((coarse.mask & ~fine.mask).any()) and coarse.mask.sum() < fine.mask.sum()
        assert coarse.networks["color_w1"] is not fine.networks["color_w1"]


def test_gradients_of_levels_add_up_by_their_weights() -> None:
    phase, state = begun(loss_weights=(2.0,))
    view, offsets = state.context.scene.train[0], state.model.offsets

    def gradient(*levels: int) -> torch.Tensor:
        for parameter in state.model.parameters():
            parameter.grad = None
        phase.train_levels(state, levels, view)
        assert offsets.grad is not None
        return offsets.grad.clone()

    both = gradient(0, 3)
    assert torch.allclose(both, gradient(0) + gradient(3), rtol=1e-4, atol=1e-7)
    assert float(both.abs().max()) > 0


def test_joint_levels_are_pruned_six_times_and_keep_their_shares(tmp_path: Path) -> None:
    context = TrainContext(tiny_scene(), tiny_config(prune_share=0.03), make_renderer("cpu"))
    t, live, anchors = open_state(context, tmp_path, Silent()), list[int](), list[list[int]]()

    class Watch(Silent):
        def on_step(self, info: StepInfo) -> None:
            if info.phase == "joint":
                masks = [part.mask for part in t.model.level_parts()]
                live.append(int(masks[-1].sum()))
                anchors.append([int(mask.any(dim=1).sum()) for mask in masks])

    assert run_training(t, tmp_path, Watch(), lambda: False)
    different = live[0:11:2]
    assert live[:-1] == [n for n in different[:5] for _ in range(2)] + [different[5]] * 9
    assert len(t.model) * t.model.slots > different[0]
    assert different == sorted(set(different), reverse=True)
    for counts in anchors[0:11:2]:
        assert counts == [pytest.approx(counts[-1] * f, abs=1) for f in (0.14, 0.35, 0.7, 1.0)]
