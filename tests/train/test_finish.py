"""Sizes to order and the finish in small runs."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from gsynopsis.cli.settings import Overrides, build_config
from gsynopsis.pipeline.packing import FilePacker
from gsynopsis.errors import SettingError
from gsynopsis.model.build import model_to_levels
from gsynopsis.render.choose import make_renderer
from gsynopsis.train.finish import FinishPhase
from gsynopsis.train.progress import Silent
from gsynopsis.train.run import freeze_others, run_training
from gsynopsis.train.trainer import Trainer
from tests.tiny import tiny_config, tiny_scene

BASE = tiny_config()


def trained(level_mib: tuple[float, ...], finish: int, out: Path) -> Trainer:
    levels = replace(BASE.levels, level_mib=level_mib, finish=finish)
    config = replace(BASE, levels=levels)
    trainer = Trainer(tiny_scene(points=120), config, make_renderer("cpu"), FilePacker())
    assert run_training(trainer, out, Silent(), lambda: False)
    return trainer


def sizes(trainer: Trainer) -> list[int]:
    assert trainer.model is not None
    return list(FilePacker().sizes(model_to_levels(trainer.model, {})))


def test_a_run_meets_the_sizes_that_were_ordered(tmp_path: Path) -> None:
    free = sizes(trained((), 0, tmp_path))
    budgets = [int(free[0] * 0.97), *(int(size * 0.95) for size in free[1:])]
    (tmp_path / "b").mkdir()
    found = sizes(trained(tuple(b / 2**20 for b in budgets), 0, tmp_path / "b"))
    for size, budget in zip(found, budgets, strict=True):
        assert 0.97 * budget <= size <= 1.02 * budget


def test_the_finish_moves_only_what_levels_own(tmp_path: Path) -> None:
    trainer = trained((), 0, tmp_path)
    phase, packer = FinishPhase(4), FilePacker()
    assert trainer.model is not None
    settled = packer.settle(model_to_levels(trainer.model, {}))
    phase.begin(trainer)
    model = trainer.model
    weights = {n: p.detach().clone() for n, p in model.named_parameters()}
    trainer.optimiser = phase.make_optimiser(trainer)
    freeze_others(trainer)
    trainer.cursor.step = 0
    while trainer.cursor.step < phase.steps:
        phase.step(trainer)
        trainer.cursor.step += 1
    moved = {n for n, p in model.named_parameters() if not torch.equal(p.detach(), weights[n])}
    assert moved
    assert all(name.startswith("parts.") for name in moved)
    after = model_to_levels(model, {})
    assert (after.shared.offsets == settled.shared.offsets).all()
    assert (packer.settle(after).shared.log_scales == settled.shared.log_scales).all()


def test_a_run_with_a_finish_ends(tmp_path: Path) -> None:
    trainer = trained((), 3, tmp_path)
    assert trainer.cursor.phase == 3


@pytest.mark.parametrize("mib", [(1.0, 0.5), (0.0, 1.0), (1.0, 2.0, -3.0)])
def test_sizes_that_do_not_rise_are_refused(mib: tuple[float, ...]) -> None:
    with pytest.raises(SettingError, match="--level-mib"):
        build_config("fast", 1.0, "every8", Overrides(level_mib=mib))


def test_as_many_levels_as_sizes() -> None:
    config = build_config("fast", 1.0, "every8", Overrides(level_mib=(1.0, 2.0, 3.0, 4.0, 5.0)))
    assert config.levels.count == 5
    with pytest.raises(SettingError, match="--level-mib"):
        build_config("paper", 1.0, "every8", Overrides(level_mib=(1.0, 2.0)))
