"""Gains of photos: solved, centred, resumable."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gsynopsis.container import encode
from gsynopsis.errors import CheckpointError
from gsynopsis.model.build import model_to_levels
from gsynopsis.render.choose import make_renderer
from gsynopsis.training.checkpoint import (
    load_state,
    read_checkpoint,
    save_checkpoint,
    write_aside,
)
from gsynopsis.training.context import TrainContext
from gsynopsis.training.loop import open_state, run_training
from gsynopsis.training.observer import Silent
from gsynopsis.training.regularize.exposure import LIMIT, Exposures, unsaturated
from gsynopsis.training.state import TrainState
from tests.tiny import tiny_config, tiny_scene


def fresh(count: int = 3) -> Exposures:
    return Exposures.identity(tuple(range(10, 10 + count)), torch.device("cpu"))


def test_the_identity_leaves_a_rendering_as_it_is_and_held_out_photos_have_none() -> None:
    image = torch.rand(4, 5, 3)
    exposures = fresh()
    assert torch.equal(exposures.applied(image, 3), image)
    assert torch.equal(exposures.applied(image, 11), image)
    exposures.solve(image, 2 * image, 3)
    assert torch.equal(exposures.log_gains, torch.zeros(3, 3)), "a photo that is not trained on"


def test_gains_are_solved_up_to_their_mean() -> None:
    exposures, image = fresh(2), 0.5 * torch.rand(32, 32, 3)
    gains = {10: torch.tensor([0.6, 0.8, 1.0]), 11: torch.tensor([1.5, 1.2, 1.0])}
    for _ in range(12):
        for view, gain in gains.items():
            exposures.solve(image, gain * image, view)
    wanted = torch.stack(list(gains.values())).log()
    wanted -= wanted.mean(dim=0)
    assert exposures.log_gains.numpy() == pytest.approx(wanted.numpy(), abs=0.05)
    assert torch.allclose(exposures.log_gains.mean(dim=0), torch.zeros(3), atol=1e-6)


def test_blur_and_noise_of_a_rendering_are_no_gain() -> None:
    torch.manual_seed(0)
    photo = 0.2 + 0.6 * torch.rand(64, 64, 3)
    for rendering in (
        photo.mean(dim=(0, 1)).expand(64, 64, 3),
        photo + 0.1 * torch.randn(64, 64, 3),
    ):
        exposures = fresh(1)
        exposures.solve(rendering, photo, 10)
        assert exposures.applied(photo, 10).numpy() == pytest.approx(photo.numpy(), abs=0.01)


def test_what_is_cut_off_or_masked_does_not_count() -> None:
    image = torch.full((8, 8, 3), 0.4)
    target, mask = 0.5 * image, torch.ones(8, 8)
    target[:2], target[2:4], mask[2:4] = 1.0, 0.9, 0.0
    exposures = fresh(2)
    exposures.solve(image, target, 10, mask)
    differing = exposures.log_gains[0] - exposures.log_gains[1]
    assert differing.exp().numpy() == pytest.approx(np.full(3, 0.5), abs=0.04)


def test_a_black_rendering_or_photo_gives_a_gain_within_limits() -> None:
    exposures, dark = fresh(2), torch.zeros(4, 4, 3)
    exposures.solve(dark, dark + 0.9, 10)
    exposures.solve(dark + 0.9, dark, 11)
    assert torch.isfinite(exposures.log_gains).all()
    assert exposures.log_gains.abs().max() <= np.log(LIMIT) + 1e-6


def test_the_gradient_of_the_rendering_is_that_of_the_exposed_one() -> None:
    exposures = fresh()
    exposures.log_gains[1] = np.log(0.5)
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
    one, image = fresh(), torch.rand(4, 4, 3)
    one.solve(image, 0.7 * image, 12)
    two = Exposures({name: t.clone() for name, t in one.tensors().items()}, (10, 11, 12))
    for exposures in (one, two):
        exposures.solve(image, 0.5 * image, 12)
    assert all(torch.equal(t, two.tensors()[name]) for name, t in one.tensors().items())


def exposed(out: Path, exposure: str = "on") -> TrainState:
    config = tiny_config()
    config = replace(config, train=replace(config.train, exposure=exposure))
    out.mkdir(exist_ok=True)
    return open_state(TrainContext(tiny_scene(), config, make_renderer("cpu")), out, Silent())


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
    assert torch.equal(whole.exposures.log_gains, state.exposures.log_gains)
    assert whole.exposures.log_gains.any()
    levels = [encode(model_to_levels(s.model, {}), "raw") for s in (whole, state)]
    assert levels[0] == levels[1]


def test_exposure_is_not_learnt_unless_it_is_on(tmp_path) -> None:
    assert exposed(tmp_path, "off").exposures is None
    assert exposed(tmp_path, "auto").exposures is None


@pytest.mark.parametrize(
    "tensors",
    [
        {},
        {"matrices": torch.zeros(7, 3, 4), "visits": torch.zeros(7)},  # of an older version
        {"log_gains": torch.zeros(6, 3), "visits": torch.zeros(7)},
        {"log_gains": torch.full((7, 3), torch.nan), "visits": torch.zeros(7)},
        {"log_gains": torch.zeros(7, 3, dtype=torch.int64), "visits": torch.zeros(7)},
    ],
)
def test_gains_of_other_photos_or_versions_are_refused(tmp_path: Path, tensors) -> None:
    state, path = exposed(tmp_path), tmp_path / "checkpoint.safetensors"
    save_checkpoint(state, path)
    record, held = read_checkpoint(path)
    others = {n: t for n, t in held.items() if not n.startswith("exposure.")}
    changed = others | {f"exposure.{name}": tensor for name, tensor in tensors.items()}
    write_aside(changed, {"state": json.dumps(record)}, path)
    with pytest.raises(CheckpointError, match="exposure"):
        load_state(state.context, path)
