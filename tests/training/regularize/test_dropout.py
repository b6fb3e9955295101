"""Dropout of Gaussians: how many, how opaque the others, and the same ones after a resume."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from gsynopsis.config import Config
from gsynopsis.render.choose import make_renderer
from gsynopsis.training.context import TrainContext
from gsynopsis.training.loop import run_training
from gsynopsis.training.observer import Silent
from gsynopsis.training.state import TrainState, fresh_state
from gsynopsis.training.view_step import dropout_factors, forward_view
from tests.tiny import tiny_config, tiny_scene
from tests.training.test_loop import StopAfter, opened, trained


def test_the_others_are_opaquer_so_that_an_image_is_about_as_opaque() -> None:
    opacities = torch.full((100_000,), 0.4)
    factors = dropout_factors(opacities, 0.3, (0, 1, 2, 3))
    assert factors.unique().tolist() == pytest.approx([0.0, 1 / 0.7])
    assert float((factors == 0).double().mean()) == pytest.approx(0.3, abs=0.01)
    assert float((opacities * factors).mean()) == pytest.approx(0.4, abs=0.01)


def test_nothing_is_opaquer_than_opaque() -> None:
    opacities = torch.tensor([1e-30, 0.0, 0.69, 0.9, 1.0]).repeat(1000)
    factors = dropout_factors(opacities, 0.3, (5,))
    assert bool(torch.isfinite(factors).all())
    assert float((opacities * factors).max()) == pytest.approx(1.0)
    assert factors.max() <= 1 / 0.7 + 1e-6


def test_steps_and_views_differ_and_the_same_one_is_the_same() -> None:
    opacities = torch.rand(1000, generator=torch.Generator().manual_seed(0))
    one = dropout_factors(opacities, 0.5, (0, 1, 2, 3))
    assert torch.equal(one, dropout_factors(opacities, 0.5, (0, 1, 2, 3)))
    for key in ((0, 1, 2, 4), (0, 1, 3, 3), (1, 1, 2, 3)):
        assert not torch.equal(one, dropout_factors(opacities, 0.5, key))


def test_factors_are_constants_of_the_gradient() -> None:
    opacities = torch.rand(50).requires_grad_(True)
    factors = dropout_factors(opacities, 0.3, (1,))
    (opacities * factors).sum().backward()
    assert opacities.grad is not None and torch.equal(opacities.grad, factors)


def config_of(share: float) -> Config:
    config = tiny_config()
    return replace(config, train=replace(config.train, dropout=share))


def state_of(share: float) -> TrainState:
    return fresh_state(TrainContext(tiny_scene(), config_of(share), make_renderer("cpu")))


def test_an_image_lacks_gaussians_and_the_loss_is_of_what_is_drawn() -> None:
    whole, thinned = state_of(0.0), state_of(0.5)
    one, two = (forward_view(s, s.model.part(-1), 1, 1)[0] for s in (whole, thinned))
    assert torch.equal(one.decoded.gaussians.opacities, two.decoded.gaussians.opacities)
    assert int(two.rendering.visible.sum()) < 0.8 * int(one.rendering.visible.sum())
    assert float(one.loss.detach()) != float(two.loss.detach())


def test_a_resumed_run_leaves_out_the_same_gaussians(tmp_path: Path) -> None:
    for name in ("whole", "parts"):
        (tmp_path / name).mkdir()
    whole = trained(config_of(0.3), tmp_path / "whole")
    parts = tmp_path / "parts"
    assert not run_training(opened(parts, config_of(0.3)), parts, Silent(), StopAfter(14))
    resumed = opened(parts, config_of(0.3))
    assert run_training(resumed, parts, Silent(), lambda: False)
    for name, value in whole.model.state_dict().items():
        assert torch.equal(value, resumed.model.state_dict()[name]), name
