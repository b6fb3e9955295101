"""Sub-pixel jitter: camera and photo agree, and only where there is detail."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from gsynopsis.evaluation.metrics import to_bytes
from gsynopsis.render.choose import make_renderer
from gsynopsis.scene.camera import STILL, Shift
from gsynopsis.scene.scene import PhotoCache
from gsynopsis.training.context import TrainContext
from gsynopsis.training.regularize.jitter import photo_bytes, shift_places, subpixels_of
from gsynopsis.training.state import TrainState, fresh_state, set_model
from gsynopsis.training.step import draw_jitter, next_view, next_views
from gsynopsis.training.view_step import forward_view, load_target
from tests.tiny import half_size, tiny_config, tiny_model, tiny_scene

VIEW = 1


@pytest.fixture
def state(tmp_path: Path) -> TrainState:
    """A model before photos of itself, 96 × 64 pixels, which it is to see at half their size."""
    renderer, scene, model = make_renderer("cpu"), tiny_scene(size=(96, 64)), tiny_model()
    views = list(scene.views)
    with torch.no_grad():
        camera = scene.camera(VIEW)
        rendering = renderer.render(model.decode(camera, 0), camera, torch.zeros(3))
    path = tmp_path / "photo.png"
    Image.fromarray(np.asarray(to_bytes(rendering.image))).save(path)
    views[VIEW] = replace(views[VIEW], path=path)
    scene = replace(scene, views=tuple(views), cache=PhotoCache())
    state = fresh_state(TrainContext(scene, half_size(tiny_config()), renderer))
    set_model(state, model)
    return state


def error(state: TrainState, drawn: Shift, sampled: Shift) -> float:
    """Mean squared difference of a rendered image and a photo, each at its own jitter."""
    camera = state.context.scene.camera(VIEW, 2, drawn)
    with torch.no_grad():
        gaussians = state.model.decode(camera, 0)
        image = state.context.renderer.render(gaussians, camera, state.background).image
    return float((image - load_target(state, VIEW, 2, sampled)).square().mean())


@pytest.mark.parametrize("jitter", [(0.25, 0.25), (-0.25, 0.25), (0.5, 0.0), (0.0, -0.5)])
def test_image_and_photo_agree_at_the_same_jitter_and_at_no_other(
    state: TrainState, jitter: Shift
) -> None:
    right = error(state, jitter, jitter)
    for other in (STILL, (-jitter[0], -jitter[1]), (-jitter[1] - 0.2, jitter[0])):
        assert right < 0.8 * error(state, jitter, other)
    state.jitter = jitter
    seen = forward_view(state, state.model.part(0), VIEW, 2)[0]
    assert seen.error == pytest.approx(right, rel=1e-6)


def test_photos_that_are_hardly_reduced_have_no_jitter_and_however_many_have_it(
    state: TrainState,
) -> None:
    scene, half = state.context.scene, state.context.config
    assert photo_bytes(scene, half) == 4 * 3 * 48 * 32 * len(scene.train)
    assert subpixels_of(half) == 2 and subpixels_of(replace(half, scale=1.5)) == 1
    small = replace(scene, cache=PhotoCache(budget=1))
    other = fresh_state(TrainContext(small, half, state.context.renderer))
    next_views(other)
    assert other.jitter != STILL


def test_places_are_all_that_can_be_drawn() -> None:
    chance = np.random.default_rng(0)
    for subpixels in (2, 3, 8):
        drawn = {draw_jitter(chance, shift_places(subpixels)) for _ in range(2000)}
        assert drawn == set(shift_places(subpixels)) and len(drawn) == subpixels**2
    assert shift_places(1) == [STILL]


def test_each_step_draws_one_of_the_places_and_a_single_place_draws_nothing(
    state: TrainState,
) -> None:
    found = set()
    for _ in range(60):
        next_views(state)
        found.add(state.jitter)
    assert found == {(a, b) for a in (-0.25, 0.25) for b in (-0.25, 0.25)}
    plain = fresh_state(TrainContext(state.context.scene, tiny_config(), state.context.renderer))
    order = [next_view(plain) for _ in range(20)]
    again = fresh_state(TrainContext(state.context.scene, tiny_config(), state.context.renderer))
    assert [next_views(again) for _ in range(20)] == [[view] for view in order]
    assert again.jitter == STILL
