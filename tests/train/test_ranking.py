"""Ranks of slots and anchors, and which levels learn in a step."""

import itertools

import pytest
import torch

from gsynopsis.model.anchors import AnchorModel
from gsynopsis.render.base import removal_effects
from gsynopsis.train.joint import JointPhase
from gsynopsis.train.ranking import anchor_cost, rank_levels, slot_effects
from gsynopsis.train.trainer import Trainer
from tests.tiny import tiny_config, tiny_model
from tests.train.test_run import trainer


@pytest.fixture
def begun() -> tuple[Trainer, AnchorModel]:
    """A trainer whose model has its levels, and shows something."""
    t = trainer(tiny_config(faint_share=0.2, spread=0.1))
    t.model = tiny_model()
    JointPhase(20, 30).begin(t)
    return t, t.model


def test_effects_of_slots_are_those_of_their_gaussians_in_all_views(
    begun: tuple[Trainer, AnchorModel],
) -> None:
    t, model = begun
    expected = torch.zeros(len(model) * model.slots)
    for view in t.scene.train:
        camera, chance = t.scene.camera(view, 1.0), torch.Generator().manual_seed(view)
        decoded = model.decode_part(model.part(-1), camera)
        gaussians = decoded.gaussians
        found = removal_effects(t.renderer, gaussians, camera, t.background, chance)
        expected[decoded.slots] += found
    effects = slot_effects(t, -1)
    assert torch.allclose(effects.reshape(-1), expected)
    assert (effects >= 0).all() and (effects > 0).any()
    assert not effects[~model.part(-1).mask].any(), "what is switched off has no effect"


def test_ranking_draws_nothing_from_the_run_and_repeats_itself(
    begun: tuple[Trainer, AnchorModel],
) -> None:
    t, _ = begun
    before = t.rng.bit_generator.state, t.generator.get_state()
    first, second = slot_effects(t, 0), slot_effects(t, 0)
    assert first.equal(second)
    assert before[0] == t.rng.bit_generator.state and before[1].equal(t.generator.get_state())


def test_levels_are_nested_and_the_coarsest_keeps_all_slots_of_its_anchors(
    begun: tuple[Trainer, AnchorModel],
) -> None:
    t, model = begun
    whole = model.part(-1).mask.clone()
    rank_levels(t)
    masks = [model.part(k).mask for k in range(len(model.parts))]
    for coarse, fine in itertools.pairwise(masks):
        assert not (coarse & ~fine).any()
    anchors = masks[0].any(dim=1)
    assert masks[0][anchors].equal(whole[anchors])
    assert 0 < masks[-1].sum() < whole.sum()


def test_an_anchor_costs_as_many_slots_as_its_values_are_worth() -> None:
    model = tiny_model()
    assert anchor_cost(model) == (6 + model.residual.shape[1]) / 3


@pytest.mark.parametrize("together", [1, 2, 4])
def test_the_finest_level_learns_in_every_step_and_the_others_take_turns(
    together: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    t = trainer(tiny_config(together=together, always_finest=True))
    t.model = tiny_model()
    phase, drawn = JointPhase(20, 30), list[list[int]]()
    phase.begin(t)
    t.optimiser = phase.make_optimiser(t)
    monkeypatch.setattr(t, "learn_levels", lambda levels, view: drawn.append(list(levels)))
    for _ in range(40):
        phase.step(t)
    finest = len(t.model.parts) - 1
    assert all(finest in levels and len(set(levels)) == together for levels in drawn)
    seen = {level for levels in drawn for level in levels}
    assert seen == (set(range(finest + 1)) if together > 1 else {finest})


def test_coarse_levels_pull_less_on_what_all_share() -> None:
    found: list[list[torch.Tensor]] = []
    for weights in ((), (0.5, 0.25)):
        t = trainer(tiny_config(weights=weights))
        t.model = tiny_model()
        phase, grads = JointPhase(20, 30), list[torch.Tensor]()
        phase.begin(t)
        for level in range(len(t.model.parts)):
            t.learn_levels([level], t.scene.train[0])
            assert t.model.offsets.grad is not None
            grads.append(t.model.offsets.grad)
            t.model.zero_grad()
        found.append(grads)
    for factor, plain, weighted in zip((0.5, 0.25, 1.0, 1.0), *found, strict=True):
        assert float(plain.abs().max()) > 0
        assert torch.equal(plain * factor, weighted)
