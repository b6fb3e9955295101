"""Masks by bytes, with a packer whose sizes are known."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gsynopsis.config import Joint
from gsynopsis.jobs.write_file import FilePacker
from gsynopsis.model.build import model_from_levels, model_to_levels
from gsynopsis.records import LevelSet, Sensitivity
from gsynopsis.render.choose import make_renderer
from gsynopsis.training.context import TrainContext
from gsynopsis.training.levels.selection import largest_multipliers, rank_levels
from gsynopsis.training.levels.size_budget import AHEAD, fit_masks
from gsynopsis.training.loop import open_state, run_training
from gsynopsis.training.observer import Silent
from gsynopsis.training.state import TrainState
from tests.level_sets import Shape, make_level_set
from tests.tiny import tiny_config, tiny_scene


class CountingPacker:
    """A file of 100 bytes per level and 10 per live slot."""

    def __init__(self) -> None:
        self.asked = 0

    def sizes(self, levels: LevelSet) -> list[int]:
        self.asked += 1
        return [100 * (k + 1) + 10 * level.live for k, level in enumerate(levels.levels)]

    def rounded(self, levels: LevelSet, sensitivity: Sensitivity, loss: float) -> LevelSet:
        return levels


@pytest.fixture
def levels(rng: np.random.Generator) -> LevelSet:
    return make_level_set(rng, Shape(anchors=(60, 150, 300), grids=(1, 1, 2), slots=5))


def test_each_level_takes_the_best_slots_its_bytes_allow(levels: LevelSet) -> None:
    model, packer = model_from_levels(levels), CountingPacker()
    ranks = torch.rand(300, 5, generator=torch.Generator().manual_seed(0)) + 0.1
    before = [model.part(k).mask.clone() for k in range(3)]
    masks = fit_masks(model, [ranks] * 3, [1100, 4200, 9300], packer)
    assert [int(m.sum()) for m in masks] == pytest.approx([100, 400, 900], rel=0.005)
    for coarse, fine in itertools.pairwise(masks):
        assert not bool((coarse & ~fine).any())
    for mask in masks:
        assert float(ranks[mask].min()) >= float(ranks[~mask].max())
    assert packer.asked <= 3 * 14
    assert all(bool((model.part(k).mask == before[k]).all()) for k in range(3))


def test_a_budget_out_of_reach_gives_all_or_the_least(levels: LevelSet) -> None:
    model = model_from_levels(levels)
    ranks = torch.ones(300, 5)
    ranks[0, 0] = 0
    masks = fit_masks(model, [ranks] * 3, [1, 2, 10**9], CountingPacker())
    assert [int(m.sum()) for m in masks] == [1, 1, 1499]


def test_real_files_meet_their_budgets_within_two_percent(levels: LevelSet) -> None:
    model, packer = model_from_levels(levels), FilePacker()
    whole = packer.sizes(model_to_levels(model, {}))
    ranks = torch.rand(300, 5, generator=torch.Generator().manual_seed(1)) + 0.1
    budgets = [int(whole[0] * 0.9), int(whole[1] * 0.95), int(whole[2] * 0.97)]
    for number, mask in enumerate(fit_masks(model, [ranks] * 3, budgets, packer)):
        model.part(number).mask = mask
    found = packer.sizes(model_to_levels(model, {}))
    for size, budget in zip(found, budgets, strict=True):
        assert 0.98 * budget <= size <= 1.02 * budget


def run_state(out: Path, level_mib: tuple[float, ...] = ()) -> TrainState:
    """A small training at its end."""
    context = TrainContext(
        tiny_scene(), tiny_config(level_mib=level_mib), make_renderer("cpu"), FilePacker()
    )
    state = open_state(context, out, Silent())
    assert run_training(state, out, Silent(), lambda: False)
    return state


def run_sizes(out: Path, level_mib: tuple[float, ...] = ()) -> list[int]:
    """Bytes up to each level's end after a small training."""
    return list(FilePacker().sizes(model_to_levels(run_state(out, level_mib).model, {})))


def test_a_run_meets_the_sizes_that_were_ordered(tmp_path: Path) -> None:
    (tmp_path / "ordered").mkdir()
    free = run_sizes(tmp_path)
    budgets = [int(free[0] * 0.97), *(int(size * 0.95) for size in free[1:])]
    sizes = run_sizes(tmp_path / "ordered", tuple(budget / 2**20 for budget in budgets))
    for size, budget in zip(sizes, budgets, strict=True):
        assert 0.97 * budget <= size <= 1.02 * budget


def test_the_finest_level_comes_to_its_size_in_equal_ratios(tmp_path: Path) -> None:
    """Cut at once, at the end, an object had 22.9 dB in as many bytes as 31.8."""
    state = run_state(tmp_path)
    *coarse, finest = FilePacker().sizes(model_to_levels(state.model, {}))
    joint = state.context.config.levels
    assert isinstance(joint, Joint)
    sizes = [size / AHEAD / 2**20 for size in (*coarse, 0.96 * finest)]
    ordered, found = replace(joint, level_mib=tuple(sizes)), [finest]
    for later in (1, 0):
        rank_levels(state, ordered, later)
        found.append(FilePacker().sizes(model_to_levels(state.model, {}))[-1])
    assert found[2] == pytest.approx(0.96 * found[0], rel=0.006)
    assert found[1] == pytest.approx(0.96**0.5 * found[0], rel=0.006)


def test_bytes_go_to_what_shows_most_for_them() -> None:
    """A slot of an anchor that stays costs less than one that needs an anchor of its own."""
    effects = torch.tensor([[4.0, 2.0, 0.0], [5.0, 0.0, 0.0], [1.0, 1.0, 0.1]])
    worth = largest_multipliers(effects, 3.0)
    order = torch.sort(worth.reshape(-1), descending=True, stable=True).indices.tolist()
    assert order[:3] == [3, 0, 1] or order[:3] == [0, 1, 3]
    assert worth[0, 1] > worth[2, 0]
