"""Native passes in order against autograd over the same kernels: the same bits."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from gsynopsis.config import Config
from gsynopsis.model.anchors import AnchorModel
from gsynopsis.render.choose import make_renderer
from gsynopsis.scene.camera import Shift
from gsynopsis.scene.scene import Scene
from gsynopsis.training import view_step
from gsynopsis.training.context import TrainContext
from gsynopsis.training.loop import open_state, run_training
from gsynopsis.training.observer import Silent
from gsynopsis.training.state import TrainState, fresh_state
from gsynopsis.training.view_step import train_view
from tests.tiny import tiny_config, tiny_scene

OURS = {"feature": "synopsis", "codebook": 0, "grids": 0, "residual": 6}
CONFIGS: dict[str, Callable[[], Config]] = {
    "joint": tiny_config,
    "tied, values of each anchor": lambda: _with_model(tiny_config(weights="tied"), **OURS),
    "sequential": lambda: tiny_config(mode="sequential"),
    "several photos a step": lambda: _with_train(tiny_config(), batch=2),
    "exposures": lambda: _with_train(tiny_config(), exposure="on"),
    "reduced photos first": lambda: _with_train(tiny_config(), reduced_until=(0.2, 0.6)),
    "dropout": lambda: _with_train(tiny_config(), dropout=0.3),
}


def _with_model(config: Config, **settings: object) -> Config:
    return replace(config, model=replace(config.model, **settings))  # type: ignore[arg-type]


def _with_train(config: Config, **settings: object) -> Config:
    return replace(config, train=replace(config.train, **settings))  # type: ignore[arg-type]


def trained(config: Config, folder: Path) -> TrainState:
    folder.mkdir()
    state = open_state(TrainContext(tiny_scene(), config, make_renderer("cpu")), folder, Silent())
    assert run_training(state, folder, Silent(), lambda: False)
    return state


def by_autograd(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(AnchorModel, "is_native", lambda self, part: False)


def assert_same(found: dict[str, Tensor], expected: dict[str, Tensor]) -> None:
    assert found.keys() == expected.keys()
    assert [name for name, value in expected.items() if not torch.equal(found[name], value)] == []


@pytest.mark.parametrize("name", CONFIGS)
def test_a_training_is_the_same_bits_as_by_autograd(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    native = trained(CONFIGS[name](), tmp_path / "native")
    by_autograd(monkeypatch)
    oracle = trained(CONFIGS[name](), tmp_path / "oracle")
    assert_same(native.model.state_dict(), oracle.model.state_dict())
    assert native.progress.loss == oracle.progress.loss > 0
    if native.exposures is not None and oracle.exposures is not None:
        assert_same(native.exposures.tensors(), oracle.exposures.tensors())


def test_masked_photos_give_the_same_bits_as_by_autograd(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def mask(self: Scene, view: int, factor: float, *_: object) -> np.ndarray:
        camera = self.camera(view, factor)
        return (np.arange(camera.width) < 9)[None].repeat(camera.height, 0).astype(np.float32)

    monkeypatch.setattr(Scene, "mask", mask)
    native = trained(tiny_config(), tmp_path / "native")
    by_autograd(monkeypatch)
    oracle = trained(tiny_config(), tmp_path / "oracle")
    assert_same(native.model.state_dict(), oracle.model.state_dict())


def gradients(state: TrainState, weights: tuple[float, ...]) -> dict[str, Tensor]:
    for parameter in state.model.parameters():
        parameter.grad = None
    for weight in weights:
        train_view(state, state.model.part(-1), state.context.scene.train[0], 1.0, weight)
    named = state.model.named_parameters()
    return {name: p.grad for name, p in named if p.grad is not None}


def test_gradients_of_several_passes_add_up_and_are_for_what_wants_them() -> None:
    state = fresh_state(TrainContext(tiny_scene(), tiny_config(), make_renderer("cpu")))
    once, twice = gradients(state, (1.0,)), gradients(state, (1.0, 0.5))
    assert {"offsets", "log_scales", "residual", "table"} <= once.keys()
    assert max(float(grad.abs().max()) for grad in once.values() if grad.numel()) > 0
    for name, grad in once.items():
        assert torch.allclose(twice[name], 1.5 * grad, rtol=1e-4, atol=1e-7), name
    state.model.offsets.requires_grad_(False)
    state.model.table.requires_grad_(False)
    assert once.keys() - gradients(state, (1.0,)).keys() == {"offsets", "table"}


def test_what_has_no_native_kernel_goes_through_autograd() -> None:
    fused = _with_model(tiny_config(), fusion="mlp")
    state = fresh_state(TrainContext(tiny_scene(), fused, make_renderer("cpu")))
    assert not state.model.is_native(state.model.part(-1))
    assert "parts.0.networks.fuse_w1" in gradients(state, (1.0,))
    plain = fresh_state(TrainContext(tiny_scene(), tiny_config(), make_renderer("reference")))
    assert plain.model.is_native(plain.model.part(-1)) and gradients(plain, (1.0,))


def test_photos_are_divided_by_shares_of_all_steps_whatever_the_phase(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: dict[float, set[float]] = {}
    load = view_step.load_target

    def noted(state: TrainState, view: int, factor: float, *jitter: Shift) -> Tensor:
        photo, step = load(state, view, factor, *jitter), state.progress.step + 1
        share = (step + 30 * (state.progress.phase > 0)) / 50
        found.setdefault(share, set()).update((factor, 24 / photo.shape[1]))
        return photo

    monkeypatch.setattr(view_step, "load_target", noted)
    config = replace(_with_train(tiny_config(), reduced_until=(0.3, 0.7)), scale=1.5)
    trained(config, tmp_path / "run")
    # The levels' values are rounded by what whole photos tell, after the last step.
    assert {share: max(factors) for share, factors in found.items()} == {
        step / 50: 6.0 if step < 15 else 3.0 if step < 35 else 1.5 for step in range(1, 51)
    }
