"""State of a training: what an optimizer moves, and the figures on display."""

import pytest
import torch

from gsynopsis.model.levels import coarser_part
from gsynopsis.render.choose import make_renderer
from gsynopsis.training.context import TrainContext
from gsynopsis.training.optim.adam import Optimizer
from gsynopsis.training.state import Progress, TrainState, fresh_state, set_model, set_optimizer
from tests.tiny import tiny_config, tiny_model, tiny_scene


def state_of(**settings: str) -> TrainState:
    return fresh_state(TrainContext(tiny_scene(), tiny_config(**settings), make_renderer("cpu")))


def test_the_same_seed_begins_alike() -> None:
    first, second = state_of(), state_of()
    for name, values in first.model.state_dict().items():
        assert torch.equal(values, second.model.state_dict()[name]), name
    assert first.rng.random() == second.rng.random()


def test_only_what_the_optimizer_moves_has_gradients_from_now_on() -> None:
    state = state_of()
    state.model.offsets.grad = torch.ones_like(state.model.offsets)
    set_optimizer(state, Optimizer({"offsets": state.model.offsets}, {"offsets": (0.1, 0.1)}))
    wanted = [name for name, p in state.model.named_parameters() if p.requires_grad]
    assert wanted == ["offsets"] and state.model.offsets.grad is None


def test_moments_of_a_checkpoint_go_to_the_next_optimizer_once() -> None:
    state = state_of()
    offsets = state.model.offsets
    state.moments = {
        "offsets.step": torch.tensor(3.0),
        "offsets.exp_avg": torch.ones_like(offsets),
        "offsets.exp_avg_sq": torch.ones_like(offsets),
    }
    set_optimizer(state, Optimizer({"offsets": offsets}, {"offsets": (0.1, 0.1)}))
    assert float(state.optimizer.state[offsets]["step"]) == 3 and state.moments == {}


def test_another_model_has_its_weights_tied_again() -> None:
    state = state_of(weights="tied")
    model = tiny_model()
    finest = model.part(0)
    model.parts.insert(0, coarser_part(model, finest, finest.mask.clone(), finest.grids))
    assert model.part(0).networks["opacity_w2"] is not finest.networks["opacity_w2"]
    set_model(state, model)
    assert model.part(0).networks["opacity_w2"] is finest.networks["opacity_w2"]


def test_psnr_is_that_of_the_smoothed_error_and_bounded() -> None:
    assert Progress(error=0.01).psnr == pytest.approx(20)
    assert Progress(error=0.0).psnr == pytest.approx(100)
