"""Ranks of slots and anchors, and which levels learn in a step."""

import itertools
from typing import Any

import pytest
import torch

from gsynopsis.config import Joint
from gsynopsis.render.measures import removal_effects
from gsynopsis.training.levels.selection import (
    anchor_cost,
    anchor_scores,
    coverage_cell,
    coverage_weighted_scores,
    drop_empty_anchors,
    nested_masks,
    octaves_of,
    prune_unseen_slots,
    rank_levels,
    rank_masks,
    rate_distortion_masks,
    slot_effects,
    slot_scores,
)
from gsynopsis.training.phases.joint import JointPhase
from gsynopsis.training.state import TrainState, fresh_state, set_model, set_optimizer
from tests.tiny import tiny_config, tiny_model
from tests.training.test_loop import context


def test_nested_masks_add_what_a_coarser_level_shows() -> None:
    coarse, fine = torch.tensor([[True, False]]), torch.tensor([[False, True]])
    assert nested_masks([coarse, fine])[1].tolist() == [[True, True]]


def test_rank_masks_keep_the_best_and_at_least_one() -> None:
    masks = rank_masks([torch.tensor([0.1, 0.9, 0.5])] * 3, [0.01, 0.67, 1.0], 2)
    assert masks[0].tolist() == [[False] * 2, [True] * 2, [False] * 2]
    assert masks[1][:, 0].tolist() == [False, True, True] and bool(masks[2].all())


def test_rank_masks_keep_what_coarser_levels_have_whatever_its_score_is() -> None:
    coarse, fine = torch.tensor([9.0, 1.0, 2.0, 3.0]), torch.tensor([0.0, 5.0, 7.0, 6.0])
    masks = rank_masks([coarse, fine, fine], [0.25, 0.5, 0.75], 1)
    rows = [mask[:, 0].tolist() for mask in masks]
    assert rows == [
        [True, False, False, False],
        [True, False, True, False],
        [True, False, True, True],
    ]


def test_pruning_drops_at_most_a_share_of_the_removal_effect() -> None:
    effects = torch.tensor([[0.0, 1.0, 40.0], [3.0, 50.0, 6.0]])
    masks = rate_distortion_masks(effects, (0.0, 0.011, 0.0399, 0.101, 0.99), 0.0)
    assert masks[0].all()
    assert masks[1].tolist() == [[False, False, True], [True, True, True]]
    assert masks[2].equal(masks[1])
    assert masks[3].tolist() == [[False, False, True], [False, True, False]]
    assert masks[4].sum() == 1, "the strongest stays"
    assert rate_distortion_masks(torch.zeros(2, 3), [0.1], 0.0)[0].all(), "nothing is less"
    assert rate_distortion_masks(effects.log(), [0.1], 0.0)[0].all(), (
        "not finite: whoever trains on says so"
    )


def bisected(effects: torch.Tensor, share: float, cost: float) -> torch.Tensor:
    """The oracle: λ by halving what it lies between."""
    effects = effects.double()
    total, low, high = float(effects.sum()), 0.0, float(effects.sum(dim=1).max())

    def kept(multiplier: float) -> torch.Tensor:
        excess = (effects - multiplier).clamp(min=0)
        return (excess > 0) & (excess.sum(dim=1, keepdim=True) > multiplier * cost)

    for _ in range(50):
        middle = (low + high) / 2
        lost = total - float((effects * kept(middle)).sum())
        low, high = (middle, high) if lost <= share * total else (low, middle)
    return kept(low)


@pytest.mark.parametrize("cost", [0.0, 0.7, 6.0])
@pytest.mark.parametrize("seed", range(12))
def test_the_multiplier_is_that_of_a_bisection(seed: int, cost: float) -> None:
    generator = torch.Generator().manual_seed(seed)
    shape = 1 + 37 * seed, 1 + seed
    effects = torch.rand(shape, generator=generator) ** (seed + 1)
    effects *= torch.rand(shape, generator=generator) < 0.7
    effects[0, 0] = 0.3
    shares = (0.003, 0.03, 0.3, 0.9)
    for share, mask in zip(shares, rate_distortion_masks(effects, shares, cost), strict=True):
        assert mask.equal(bisected(effects, share, cost))


def test_equal_slots_stay_or_go_together() -> None:
    effects = torch.tensor([[2.0], [2.0], [2.0], [9.0]])
    masks = rate_distortion_masks(effects, (0.2, 0.39, 0.41), 1.0)
    assert [mask.sum() for mask in masks] == [4, 4, 1]


def test_pruning_keeps_the_most_removal_effect_for_its_rate() -> None:
    """The oracle: of all choices, none that loses as little takes less room."""
    generator = torch.Generator().manual_seed(3)
    for cost in (0.0, 0.7, 2.0):
        effects = torch.rand(4, 3, generator=generator) ** 3
        kept = rate_distortion_masks(effects, [0.2], cost)[0]
        assert 0 < kept.sum() < 12
        every = torch.cartesian_prod(*[torch.tensor([False, True])] * 12).view(-1, 4, 3)
        left = (effects * every).sum(dim=(1, 2))
        room = every.sum(dim=(1, 2)) + cost * every.any(dim=2).sum(dim=1)
        own = int(kept.sum()) + cost * int(kept.any(dim=1).sum())
        best = left[room <= own + 1e-6].max()
        assert (effects * kept).sum() == pytest.approx(float(best))
        assert (effects * ~kept).sum() <= 0.2 * effects.sum()


def test_spread_scores_keep_an_anchor_in_every_region() -> None:
    near = torch.cartesian_prod(*[torch.arange(6)] * 3)
    far = torch.tensor([[400, 0, 0], [0, 400, 0], [0, 0, 400]])
    lattice = torch.cat([near, far])
    scores = torch.cat([torch.linspace(1.0, 2.0, len(near)), torch.full((3,), 0.5)])
    octaves = torch.zeros(len(lattice), dtype=torch.int64)
    cell = coverage_cell(lattice, octaves, 0.05)
    best = torch.topk(coverage_weighted_scores(lattice, octaves, scores, cell), 24).indices
    assert {216, 217, 218} <= set(best.tolist())
    assert int(best[0]) == 215  # the best of a cell keeps its score
    assert not (torch.topk(scores, 24).indices >= 216).any()


def test_spread_scores_of_one_anchor_and_of_equal_ones() -> None:
    lattice = torch.zeros(3, 3, dtype=torch.int64)
    none = torch.zeros(3, dtype=torch.int64)
    one = coverage_weighted_scores(lattice[:1], none[:1], torch.tensor([3.0]), 2)
    assert one.tolist() == [3.0]
    same = coverage_weighted_scores(lattice, none, torch.ones(3), 2)
    assert same.tolist() == pytest.approx([1.0, 2**-0.5, 3**-0.5])


def test_octaves_count_doublings_of_the_cameras_extent() -> None:
    places = torch.tensor([[1.0, 2, 3], [2.9, 2, 3], [5.1, 2, 3], [1, -6.1, 3], [1, 2, 1e30]])
    octaves = octaves_of(places, torch.tensor([1.0, 2, 3]), 2.0)
    assert octaves.tolist() == [0, 0, 1, 2, 16]


def test_far_anchors_share_cells_as_wide_as_they_are_far() -> None:
    near = torch.cartesian_prod(*[torch.arange(4)] * 3)
    lattice = torch.cat([near, near * 16 + 640, -(near * 16) - 640])
    octaves = torch.tensor([0, 4, 4]).repeat_interleave(len(near))
    scores = coverage_weighted_scores(lattice, octaves, torch.ones(len(lattice)), 2)
    apart = scores.view(3, -1).sort(dim=1).values
    assert torch.equal(apart[0], apart[1])
    assert torch.equal(apart[0], torch.arange(8, 0, -1).rsqrt().repeat_interleave(8))
    # In cells of one width each of the far ones has one of its own.
    alike = coverage_weighted_scores(lattice, 0 * octaves, torch.ones(len(lattice)), 2)
    assert (alike.view(3, -1)[1:] == 1).all()
    # Wider than the lattice, on either side of it.
    edge = torch.tensor([[-(1 << 20)] * 3, [(1 << 20) - 1] * 3])
    wide = coverage_weighted_scores(edge, torch.tensor([16, 16]), torch.ones(2), 1 << 20)
    assert wide.tolist() == [1, 1]


def test_own_slots_come_before_borrowed_ones_and_dead_ones_never() -> None:
    own = torch.tensor([[0.5, 0.0, 0.0]])
    finest = torch.tensor([[0.1, 3.0, 0.0]])
    coarse = torch.tensor([[True, False, False]])
    scores = slot_scores([own, finest], [coarse, torch.ones(1, 3, dtype=torch.bool)])
    assert float(scores[0][0, 0]) > float(scores[0][0, 1]) > float(scores[0][0, 2]) == 0
    assert float(scores[1][0, 2]) == 0


def test_anchors_are_ranked_whole() -> None:
    scores = anchor_scores(
        torch.tensor([[1.0, 1.0, 0.0], [1.5, 0.0, 0.0]]), torch.tensor([2.0, 1.5])
    )
    assert scores.tolist() == [[2, 2, 0], [1.5, 0, 0]]


def joint(**levels: Any) -> tuple[TrainState, JointPhase]:
    """A training of a model that shows something, before its joint phase."""
    given = context(tiny_config(**levels))
    t = fresh_state(given)
    set_model(t, tiny_model())
    assert isinstance(given.config.levels, Joint)
    return t, JointPhase(given.config.levels, 30)


@pytest.fixture
def begun() -> tuple[TrainState, JointPhase]:
    """A training whose model has its levels, and shows something."""
    t, phase = joint(prune_share=0.2)
    phase.begin(t)
    return t, phase


def test_effects_of_slots_are_those_of_their_gaussians_in_all_views(
    begun: tuple[TrainState, JointPhase],
) -> None:
    t, model = begun[0], begun[0].model
    expected = torch.zeros(len(model) * model.slots)
    for view in t.context.scene.train:
        camera, chance = t.context.scene.camera(view, 1.0), torch.Generator().manual_seed(view)
        decoded = model.decode_part(model.part(-1), camera)
        gaussians = decoded.gaussians
        found = removal_effects(t.context.renderer, gaussians, camera, t.background, chance)
        expected[decoded.slots] += found
    effects = slot_effects(t, -1)
    assert torch.allclose(effects.reshape(-1), expected)
    assert (effects >= 0).all() and (effects > 0).any()
    assert not effects[~model.part(-1).mask].any(), "what is switched off has no effect"


def test_ranking_draws_nothing_from_the_run_and_repeats_itself(
    begun: tuple[TrainState, JointPhase],
) -> None:
    t, _ = begun
    before = t.rng.bit_generator.state, t.generator.get_state()
    first, second = slot_effects(t, 0), slot_effects(t, 0)
    assert first.equal(second)
    assert before[0] == t.rng.bit_generator.state and before[1].equal(t.generator.get_state())


def test_levels_are_nested_and_the_coarsest_keeps_all_slots_of_its_anchors(
    begun: tuple[TrainState, JointPhase],
) -> None:
    t, phase = begun
    model = t.model
    whole = dict(zip(map(tuple, model.lattice.tolist()), model.part(-1).mask, strict=True))
    rank_levels(t, phase.levels)
    masks = [model.part(k).mask for k in range(len(model.parts))]
    for coarse, fine in itertools.pairwise(masks):
        assert not (coarse & ~fine).any()
    anchors = masks[0].any(dim=1)
    before = torch.stack([whole[tuple(cell)] for cell in model.lattice[anchors].tolist()])
    assert masks[0][anchors].equal(before)
    assert 0 < masks[-1].sum() < sum(mask.sum() for mask in whole.values())


def test_slots_that_a_coarse_level_hardly_shows_come_later(
    begun: tuple[TrainState, JointPhase],
) -> None:
    t, _ = begun
    parts = t.model.level_parts()
    effects = [slot_effects(t, level) for level in range(len(parts))]
    prune_unseen_slots(t)
    seen = [part.mask.clone() for part in parts]
    prune_unseen_slots(t, 0.05)
    for part, mask, effect in zip(parts[:-1], seen, effects, strict=False):
        assert not (part.mask & ~mask).any() and part.mask.sum() < mask.sum()
        assert 0 < effect[mask & ~part.mask].sum() <= 0.05 * effect.sum()
    assert parts[-1].mask.equal(seen[-1])
    for coarse, fine in itertools.pairwise(part.mask for part in parts):
        assert not (coarse & ~fine).any()


def test_anchors_without_a_slot_leave_with_their_moments(
    begun: tuple[TrainState, JointPhase],
) -> None:
    t, phase = begun
    set_optimizer(t, phase.make_optimizer(t))
    t.progress.begun = True
    phase.step(t)
    model, moments = t.model, t.optimizer.state
    keep = torch.arange(len(model)) % 3 > 0
    for part in model.level_parts():
        part.mask = part.mask & keep[:, None]
    old = {name: getattr(model, name).detach().clone() for name in ("offsets", "log_scales")}
    first = moments[model.offsets]["exp_avg"].clone()
    cells, size = model.lattice.clone(), len(model)
    drop_empty_anchors(t)
    assert len(model) == int(keep.sum()) < size
    assert model.lattice.equal(cells[keep])
    assert all(getattr(model, name).equal(rows[keep]) for name, rows in old.items())
    assert t.optimizer.state[model.offsets]["exp_avg"].equal(first[keep])
    phase.step(t)  # and it goes on


def test_an_anchor_costs_as_many_slots_as_its_values_are_worth() -> None:
    model = tiny_model()
    assert anchor_cost(model) == (6 + model.residual.shape[1]) / 3


def levels_drawn(
    levels_per_step: float, steps: int, monkeypatch: pytest.MonkeyPatch
) -> tuple[list[list[int]], int]:
    """Levels of each of so many steps, and the finest one's number."""
    t, phase = joint(levels_per_step=levels_per_step)
    drawn = list[list[int]]()
    phase.begin(t)
    set_optimizer(t, phase.make_optimizer(t))
    monkeypatch.setattr(
        phase, "train_levels", lambda state, levels, view: drawn.append(list(levels))
    )
    for _ in range(steps):
        phase.step(t)
    return drawn, len(t.model.parts) - 1


@pytest.mark.parametrize("together", [1, 2, 4])
def test_the_finest_level_learns_in_every_step_and_the_others_take_turns(
    together: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn, finest = levels_drawn(together, 40, monkeypatch)
    assert all(finest in levels and len(set(levels)) == together for levels in drawn)
    seen = {level for levels in drawn for level in levels}
    assert seen == (set(range(finest + 1)) if together > 1 else {finest})


def test_half_a_level_more_is_one_more_in_every_second_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    counts = [len(levels) for levels in levels_drawn(2.5, 60, monkeypatch)[0]]
    assert set(counts) == {2, 3} and 15 < counts.count(3) < 45


def test_coarse_levels_pull_less_on_what_all_share() -> None:
    found: list[list[torch.Tensor]] = []
    for weights in ((), (0.5, 0.25)):
        t, phase = joint(loss_weights=weights)
        grads = list[torch.Tensor]()
        phase.begin(t)
        for level in range(len(t.model.parts)):
            phase.train_levels(t, [level], t.context.scene.train[0])
            assert t.model.offsets.grad is not None
            grads.append(t.model.offsets.grad)
            t.model.zero_grad()
        found.append(grads)
    for factor, plain, weighted in zip((0.5, 0.25, 1.0, 1.0), *found, strict=True):
        assert float(plain.abs().max()) > 0
        assert torch.equal(plain * factor, weighted)
