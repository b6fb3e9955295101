"""Sensitivity against its definition, and what rounding by it really costs the images."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gsynopsis.container import decode, encode
from gsynopsis.jobs.write_file import FilePacker
from gsynopsis.model.anchors import AnchorModel
from gsynopsis.model.build import model_from_levels, model_to_levels
from gsynopsis.model.levels import coarser_part
from gsynopsis.records import LevelSet
from gsynopsis.render.choose import make_renderer
from gsynopsis.training.context import TrainContext
from gsynopsis.training.levels import sensitivity as module
from gsynopsis.training.levels.sensitivity import BEST_ERROR, DECIBELS, sensitivity_of
from gsynopsis.training.loop import open_state, run_training
from gsynopsis.training.observer import Silent
from gsynopsis.training.phases.joint import round_values
from gsynopsis.training.state import TrainState, fresh_state, set_model
from gsynopsis.training.view_step import load_target
from tests.tiny import TINY_MODEL, tiny_config, tiny_model, tiny_scene


def trained(out: Path, coding_loss: float = 0.0) -> TrainState:
    config = tiny_config(coding_loss=coding_loss)
    context = TrainContext(tiny_scene(), config, make_renderer("cpu"), FilePacker())
    state = open_state(context, out, Silent())
    assert run_training(state, out, Silent(), lambda: False)
    return state


def with_photos(run: TrainState, views: tuple[int, ...]) -> TrainState:
    """A training on these photos alone."""
    return fresh_state(replace(run.context, scene=replace(run.context.scene, train=views)))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> TrainState:
    return trained(tmp_path_factory.mktemp("run"))


def levels_of(state: TrainState) -> LevelSet:
    return model_to_levels(state.model, {})


def images(state: TrainState, levels: LevelSet, level: int, view: int) -> torch.Tensor:
    camera = state.context.scene.camera(view, 1.0)
    with torch.no_grad():
        drawn = model_from_levels(levels).decode(camera, level)
        return state.context.renderer.render(drawn, camera, state.background).image


def by_definition(state: TrainState, level: int, view: int) -> np.ndarray:
    """Σ over pixels of the squared derivative by every log-scale, one backward pass a pixel."""
    model = model_from_levels(levels_of(state))
    camera = state.context.scene.camera(view, 1.0)
    drawn = model.decode(camera, level)
    image = state.context.renderer.render(drawn, camera, state.background).image
    total = torch.zeros_like(model.log_scales)
    for value in image.reshape(-1):
        (found,) = torch.autograd.grad(value, [model.log_scales], retain_graph=True)
        total += found.square()
    error = float((image.detach() - load_target(state, view, 1.0)).square().mean())
    return (total * DECIBELS / (max(error, BEST_ERROR) * image.numel())).numpy()


def test_random_signs_give_the_squares_of_all_derivatives(
    run: TrainState, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = with_photos(run, run.context.scene.train[:1])
    exact = by_definition(run, 0, few.context.scene.train[0])
    levels = levels_of(run).upto(0)
    seeds, total = iter(range(1000)), np.zeros_like(exact[: len(levels.shared.lattice)])

    class Chance(torch.Generator):
        def manual_seed(self, seed: int) -> torch.Generator:
            return super().manual_seed(next(seeds) * 1000 + seed)

    monkeypatch.setattr(module.torch, "Generator", Chance)
    for _ in range(200):
        total += sensitivity_of(few, levels).log_scales / 200
    exact = exact[: len(total)]
    large = exact > np.quantile(exact, 0.9)
    assert float(total[large].sum()) == pytest.approx(float(exact[large].sum()), rel=0.1)
    ratio = total[large] / exact[large]
    assert 0.5 < float(np.quantile(ratio, 0.05)) < float(np.quantile(ratio, 0.95)) < 2.0


def test_coupling_is_of_all_pairs_of_an_anchors_values(run: TrainState) -> None:
    model = tiny_model(replace(TINY_MODEL, residual=3))
    with torch.no_grad():
        model.residual.normal_(generator=torch.Generator().manual_seed(3))
    model.parts.insert(0, coarser_part(model, model.part(0), model.part(0).mask.clone(), 4))
    levels, first, second = model_to_levels(model, {}), [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]
    few = with_photos(run, run.context.scene.train[:1])
    found = sensitivity_of(few, levels)
    model = model_from_levels(levels)
    products, squares = 0.0, np.zeros(levels.shared.residual.shape)
    for level in (0, 1):
        rows, found_in = module._gradients(few, model, level, run.context.scene.train[0])
        assert rows is not None
        gradients = np.zeros(levels.shared.residual.shape)
        gradients[rows.numpy()] = found_in["residual"].numpy()
        products = products + gradients[:, first] * gradients[:, second]
        squares = np.maximum(squares, gradients**2)
    np.testing.assert_allclose(found.coupling, products, rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(found.residual, squares, rtol=1e-5, atol=1e-12)
    assert float(found.coupling.min()) < 0 < float(found.coupling.max())


def test_levels_look_at_views_in_between_those_of_others(
    run: TrainState, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[tuple[int, int]] = []
    inner = module._gradients

    def spy(state: TrainState, model: AnchorModel, level: int, view: int) -> object:
        seen.append((level, view))
        return inner(state, model, level, view)

    monkeypatch.setattr(module, "_gradients", spy)
    monkeypatch.setattr(module, "VIEWS", 2)
    train = run.context.scene.train[:4]
    few = with_photos(run, train)
    sensitivity_of(few, levels_of(run).upto(1))
    assert seen == [(0, train[0]), (0, train[2]), (1, train[1]), (1, train[3])]


def test_all_levels_count_and_the_random_states_stay(run: TrainState) -> None:
    levels, before = levels_of(run), (run.generator.get_state(), run.rng.bit_generator.state)
    every = sensitivity_of(run, levels)
    for last in range(len(levels.levels)):
        some = sensitivity_of(run, levels.upto(last))
        rows = len(some.offsets)
        assert (every.offsets[:rows] >= some.offsets).all()
    assert float(every.offsets.sum()) > 0
    assert (every.offsets[~levels.levels[-1].mask] == 0).all()
    assert (sensitivity_of(run, levels).residual == every.residual).all()
    assert torch.equal(run.generator.get_state(), before[0])
    assert run.rng.bit_generator.state == before[1]


def test_rounded_images_lose_about_what_was_ordered(run: TrainState) -> None:
    levels, packer = levels_of(run), FilePacker()
    loss = 0.4
    found = packer.rounded(levels, sensitivity_of(run, levels), loss)
    lost: list[float] = []
    for level in range(len(levels.levels)):
        of_views: list[float] = []
        for view in run.context.scene.train:
            changed = images(run, found, level, view) - images(run, levels, level, view)
            exact = images(run, levels, level, view) - load_target(run, view, 1.0)
            error = max(float(exact.square().mean()), BEST_ERROR)
            of_views.append(DECIBELS * float(changed.square().mean()) / error)
        lost.append(float(np.mean(of_views)))
    assert 0.1 * loss < max(lost) < 1.5 * loss
    assert min(lost) > 0


def test_a_run_rounds_its_values_and_a_file_holds_them(run: TrainState, tmp_path: Path) -> None:
    rounded = trained(tmp_path, 0.4)
    exact, found = levels_of(run), levels_of(rounded)
    stored = decode(encode(found), "memory")
    assert (stored.shared.offsets == found.shared.offsets).all()
    assert (stored.shared.log_scales == found.shared.log_scales).all()
    assert (stored.shared.lattice == exact.shared.lattice).all()
    assert FilePacker().sizes(found)[-1] < FilePacker().sizes(exact)[-1]
    # Sizes in float32 are of what training left; the rounded values would deflate better.
    sizes, worse = rounded.progress.trained_bytes, FilePacker().trained(found)
    assert sizes == FilePacker().trained(exact)
    assert sum(row[1] for row in sizes) > 1.05 * sum(row[1] for row in worse)
    assert [row[0] for row in sizes] == [row[0] for row in worse]
    # The same as rounding the finished run: nothing in training depends on it.
    again = fresh_state(rounded.context)
    set_model(again, model_from_levels(exact))
    round_values(again, FilePacker(), 0.4)
    assert (levels_of(again).shared.offsets == found.shared.offsets).all()


def test_values_that_are_not_finite_are_left_for_whoever_saves_them(run: TrainState) -> None:
    model = model_from_levels(levels_of(run))
    model.residual = torch.nn.Parameter(torch.full((len(model), 1), float("nan")))
    broken = fresh_state(run.context)
    set_model(broken, model)
    round_values(broken, FilePacker(), 0.4)
    assert broken.model is model


@pytest.mark.parametrize(
    "model",
    [{}, {"residual": 3}, {"feature": "free", "codebook": 0, "grids": 0}],
    ids=["codebook and grids", "residual", "free"],
)
def test_native_passes_give_the_bits_of_autograd(
    model: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = replace(tiny_config(), model=replace(tiny_config().model, **model))
    context = TrainContext(tiny_scene(), config, make_renderer("cpu"), FilePacker())
    state = open_state(context, tmp_path, Silent())
    assert run_training(state, tmp_path, Silent(), lambda: False)
    levels = levels_of(state)
    native = sensitivity_of(state, levels)
    calls: list[bool] = []
    monkeypatch.setattr(AnchorModel, "is_native", lambda self, part: bool(calls.append(True)))
    set_model(state, state.model)  # which chooses the passes
    plain = sensitivity_of(state, levels)
    assert calls and float(native.offsets.max()) > 0
    for name in ("log_scales", "offsets", "residual", "coupling"):
        assert np.array_equal(getattr(native, name), getattr(plain, name)), name
    assert len(native.grids) == len(plain.grids)
    assert all(map(np.array_equal, native.grids, plain.grids))
