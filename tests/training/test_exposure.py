"""Affine colours of photos: learnt, centred, resumable."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gsynopsis.container import encode
from gsynopsis.model.build import model_to_levels
from gsynopsis.render.choose import make_renderer
from gsynopsis.training.exposure import RATE, Exposures, unsaturated
from gsynopsis.training.progress import Silent
from gsynopsis.training.run import open_state, run_training
from gsynopsis.training.state import Setup, TrainState
from tests.tiny import tiny_config, tiny_scene


def fresh(count: int = 3) -> Exposures:
    matrices = torch.eye(3, 4).repeat(count, 1, 1)
    tensors = {"matrices": matrices, "first": torch.zeros(count, 3, 4)}
    tensors |= {"second": torch.zeros(count, 3, 4), "visits": torch.zeros(count)}
    return Exposures(tensors, tuple(range(10, 10 + count)))


def test_the_identity_leaves_a_rendering_as_it_is_and_held_out_photos_have_none() -> None:
    image = torch.rand(4, 5, 3)
    exposures = fresh()
    assert torch.equal(exposures.applied(image, 3), image)
    assert torch.allclose(exposures.applied(image, 11), image)


def test_a_step_moves_one_photo_against_its_gradient_and_the_mean_stays() -> None:
    exposures, image = fresh(), torch.rand(4, 5, 3)
    target = 1.3 * image
    (exposures.applied(image, 11) - target).square().mean().backward()
    before = exposures.matrices.clone()
    exposures.learn()
    change = exposures.matrices - before
    assert torch.allclose(exposures.matrices.mean(dim=0), torch.eye(3, 4), atol=1e-6)
    assert change[1].diagonal().min() == pytest.approx(RATE * 2 / 3, rel=1e-3)
    assert torch.allclose(change[0], change[2])


def test_gains_are_learnt_up_to_their_mean() -> None:
    exposures, image = fresh(2), torch.rand(8, 8, 3)
    gains = {10: 0.9, 11: 1.1}
    for _ in range(400):
        for view, gain in gains.items():
            (exposures.applied(image, view) - gain * image).square().mean().backward()
            exposures.learn()
    for row, gain in enumerate(gains.values()):
        error = exposures.matrices[row, :, :3].sum(dim=1) + exposures.matrices[row, :, 3]
        assert error.numpy() == pytest.approx(np.full(3, gain), abs=0.02)


def test_the_gradient_of_the_rendering_is_that_of_the_exposed_one() -> None:
    exposures = fresh()
    exposures.matrices[1] *= 0.5
    image = torch.rand(2, 2, 3, requires_grad=True)
    exposures.applied(image, 11).sum().backward()
    assert image.grad is not None and torch.allclose(image.grad, torch.full((2, 2, 3), 0.5))


def test_where_a_photo_is_white_a_brighter_rendering_is_not_wrong() -> None:
    image = torch.tensor([[[1.3, 0.9, 0.5]]], requires_grad=True)
    photo = torch.tensor([[[1.0, 1.0, 0.4]]])
    (unsaturated(image, photo) - photo).abs().sum().backward()
    assert image.grad is not None
    assert image.grad.flatten().tolist() == [0, -1, 1], "darker ones are, and what is not white"


def test_state_comes_back_from_its_tensors() -> None:
    one = fresh()
    image = torch.rand(4, 4, 3)
    one.applied(image, 12).sum().backward()
    one.learn()
    two = Exposures({name: t.clone() for name, t in one.tensors().items()}, (10, 11, 12))
    for exposures in (one, two):
        exposures.applied(image, 12).square().sum().backward()
        exposures.learn()
    assert all(torch.equal(t, two.tensors()[name]) for name, t in one.tensors().items())


def exposed(out: Path, exposure: str = "on") -> TrainState:
    config = tiny_config()
    config = replace(config, train=replace(config.train, exposure=exposure))
    out.mkdir(exist_ok=True)
    return open_state(Setup(tiny_scene(), config, make_renderer("cpu")), out, Silent())


def test_a_stopped_training_with_exposure_ends_as_one_that_was_never_stopped(tmp_path) -> None:
    whole = exposed(tmp_path / "whole")
    assert run_training(whole, tmp_path / "whole", Silent(), lambda: False)
    for stop_after in (7, 9, 1000):
        asks = iter(range(stop_after))
        state = exposed(tmp_path / "parts")
        run_training(
            state, tmp_path / "parts", Silent(), lambda asks=asks: next(asks, None) is None
        )
    assert whole.exposures is not None and state.exposures is not None
    assert torch.equal(whole.exposures.matrices, state.exposures.matrices)
    levels = [encode(model_to_levels(s.model, {}), "raw") for s in (whole, state)]
    assert levels[0] == levels[1]


def test_exposure_is_not_learnt_unless_it_is_on(tmp_path) -> None:
    assert exposed(tmp_path, "off").exposures is None
    assert exposed(tmp_path, "auto").exposures is None
