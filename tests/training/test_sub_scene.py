"""Blocks of space: they divide it, and a training of one moves nothing outside."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from gsynopsis.config import Config, replaced, resolve_settings
from gsynopsis.jobs.write_file import FilePacker
from gsynopsis.model.anchors import ROW_PARAMETERS
from gsynopsis.model.build import select_anchors
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.training.context import TrainContext
from gsynopsis.training.loop import open_state, phases_of, run_training
from gsynopsis.training.observer import Silent
from gsynopsis.training.state import TrainState, fresh_state, new_state
from gsynopsis.training.sub_scene import Region, extents, split_space
from tests.tiny import tiny_scene


@pytest.mark.parametrize("count", [1, 2, 3, 7, 40])
def test_boxes_divide_all_of_space_into_equal_shares(count: int) -> None:
    rng = np.random.default_rng(count)
    points = (rng.normal(size=(4000, 3)) * (9, 4, 1)).astype(np.float32)
    boxes = split_space(points, count)
    # Corners of boxes are points: they too lie in exactly one.
    far = rng.normal(size=(2000, 3)).astype(np.float32) * 1e3
    every = torch.from_numpy(np.concatenate([points, far]))
    held = torch.stack([box.holds(every) for box in boxes])
    assert (held.sum(dim=0) == 1).all()
    inside = held[:, : len(points)].sum(dim=1).numpy()
    assert len(boxes) == count and inside.min() > 0.8 * len(points) / count
    assert inside.max() < 1.25 * len(points) / count


def test_a_box_is_cut_across_its_longest_side() -> None:
    points = np.random.default_rng(0).uniform(0, 1, (500, 3)).astype(np.float32) * (1, 8, 1)
    low, high = split_space(points.astype(np.float32), 2)
    assert low.high[1] == high.low[1] and 3 < low.high[1] < 5
    assert low.high[0] == low.high[2] == float("inf") and low.low == Region().low


def test_points_in_one_place_are_not_lost() -> None:
    points = np.ones((10, 3), np.float32)
    held = torch.stack([box.holds(torch.from_numpy(points)) for box in split_space(points, 3)])
    assert (held.sum(dim=0) == 1).all()


def test_a_wider_box_has_its_infinite_sides_still() -> None:
    box = Region(low=(0.0, 0.0, 0.0), high=(1.0, 2.0, float("inf"))).wider((0.1, 0.2, 0.3))
    assert box.low == (-0.1, -0.2, -0.3) and box.high == (1.1, 2.2, float("inf"))
    assert (extents(np.zeros((0, 3), np.float32)) == 0).all()


@pytest.fixture
def config() -> Config:
    asked = {"train.steps": 60, "levels.steps": 40, "train.growth.every": 5}
    asked |= {"train.growth.threshold": 1e-6, "model.hidden": 8}
    return resolve_settings("standard", None, asked).config


def trained(context: TrainContext, folder: Path, start: Callable[[], TrainState]) -> TrainState:
    folder.mkdir()
    state = start()
    assert run_training(state, folder, Silent(), lambda: False)
    return state


def test_a_block_moves_its_own_anchors_and_nothing_else(config: Config, tmp_path: Path) -> None:
    scene = tiny_scene(points=400)
    plain = replaced(config, {"levels.prune_share": 0.0, "levels.coding_loss": 0.0})
    first = TrainContext(scene, plain, CpuRenderer(), FilePacker())
    whole = trained(first, tmp_path / "whole", lambda: fresh_state(first))
    x = whole.model.placed()[0]
    region = Region(low=(0.0, -float("inf"), -float("inf")))
    inside = region.holds(x)
    assert 20 < int(inside.sum()) < len(x) - 20
    before = {name: getattr(whole.model, name).detach().clone() for name in ROW_PARAMETERS}
    masks = [part.mask.clone() for part in whole.model.level_parts()]
    weights = {n: p.detach().clone() for n, p in whole.model.parts.named_parameters()}

    second = TrainContext(scene, config, CpuRenderer(), FilePacker(), region=region)
    model = select_anchors(whole.model, torch.ones(len(x), dtype=torch.bool))

    def start() -> TrainState:
        return new_state(second, model, torch.Generator().manual_seed(1), np.random.default_rng(1))

    state = trained(second, tmp_path / "block", start)
    still = ~region.holds(state.model.placed()[0])
    assert torch.equal(state.model.lattice[still], whole.model.lattice[~inside])
    for name, values in before.items():
        assert torch.equal(getattr(state.model, name)[still], values[~inside]), name
    for part, mask in zip(state.model.level_parts(), masks, strict=True):
        assert torch.equal(part.mask[still], mask[~inside])
    for name, weight in state.model.parts.named_parameters():
        assert torch.equal(weight, weights[name]), name
    # And its own moved, grew, and have levels that are nested.
    known = {tuple(cell) for cell in whole.model.lattice.tolist()}
    grown = [c for c in map(tuple, state.model.lattice[~still].tolist()) if c not in known]
    assert len(grown) > 10
    counts = [int(part.mask[~still].sum()) for part in state.model.level_parts()]
    assert counts == sorted(counts) and counts[0] < counts[-1]
    assert state.progress.phase == len(phases_of(config))


def test_a_block_goes_on_bit_for_bit(config: Config, tmp_path: Path) -> None:
    scene = tiny_scene(points=400)
    context = TrainContext(
        scene, config, CpuRenderer(), FilePacker(), region=Region(low=(0.0, 0.0, 0.0))
    )
    plain = TrainContext(scene, config, CpuRenderer(), FilePacker())
    start = trained(plain, tmp_path / "whole", lambda: fresh_state(plain)).model

    def fresh() -> TrainState:
        everything = torch.ones(len(start), dtype=torch.bool)
        model = select_anchors(start, everything)
        return new_state(context, model, torch.Generator().manual_seed(1), np.random.default_rng(1))

    once = trained(context, tmp_path / "once", fresh)
    (tmp_path / "twice").mkdir()
    asked = iter(range(10_000))
    assert not run_training(fresh(), tmp_path / "twice", Silent(), lambda: next(asked) > 70)
    again = open_state(context, tmp_path / "twice", Silent())
    assert run_training(again, tmp_path / "twice", Silent(), lambda: False)
    for name in ROW_PARAMETERS:
        assert torch.equal(getattr(once.model, name), getattr(again.model, name))
    for one, two in zip(once.model.level_parts(), again.model.level_parts(), strict=True):
        assert torch.equal(one.mask, two.mask)
