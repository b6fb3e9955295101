"""Rows that are moved when they are read, against the dense optimiser: the same bits."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor, nn

from gsynopsis._native import _core
from gsynopsis.config import Config
from gsynopsis.model.anchors import ROW_PARAMETERS, AnchorModel, RowsNear
from gsynopsis.pipeline.packing import FilePacker
from gsynopsis.render.choose import make_renderer
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.scene import Scene
from gsynopsis.scene.views import View
from gsynopsis.training import state as of_state
from gsynopsis.training.lazy import LazyRows, RowGradients
from gsynopsis.training.optimiser import Optimiser
from gsynopsis.training.progress import Silent
from gsynopsis.training.region import Region
from gsynopsis.training.run import CHECKPOINT, open_state, phases_of, run_training
from gsynopsis.training.state import Setup, TrainState
from tests.tiny import look_at, tiny_config, tiny_model, tiny_scene

FREE = {"feature": "free", "codebook": 0, "grids": 0}
RATES = {"wide": (0.02, 0.002), "narrow": (0.01, 0.01)}
RATES_OF_ROWS: dict[str, tuple[float, float]] = dict.fromkeys(ROW_PARAMETERS, (0.01, 0.01))


def street() -> Scene:
    """A long row of points, and cameras of which each sees a stretch of it."""
    scene = tiny_scene(views=11, points=400)
    views = []
    for k, view in enumerate(scene.views):
        place = np.array([3.0 * (k - 5), 0.0, 0.0])
        camera = look_at(place + np.array([0.5, -0.5, -2.0]), place, 24, 16)
        views.append(View(view.name, camera, view.path))
    stretched = scene.points * np.array([18.0, 0.7, 0.7])
    return replace(scene, views=tuple(views), points=stretched)


def with_train(config: Config, **settings: object) -> Config:
    return replace(config, train=replace(config.train, **settings))  # type: ignore[arg-type]


def with_model(config: Config, **settings: object) -> Config:
    return replace(config, model=replace(config.model, **settings))  # type: ignore[arg-type]


JOINT = with_train(tiny_config(prune_share=0.03, coding_loss=0.05), weight_average=0.5)
CONFIGS: dict[str, Config] = {
    "joint": JOINT,
    "tied": replace(JOINT, levels=replace(JOINT.levels, weights="tied")),  # type: ignore[arg-type]
    "batch 2": with_train(JOINT, batch=2),
    "batch 4, exposures": with_train(JOINT, batch=4, exposure="on"),
    "values of each anchor": with_model(JOINT, **FREE),
    "sequential": with_train(tiny_config(mode="sequential"), weight_average=0.5),
    "fusion MLP": with_model(JOINT, fusion="mlp"),
    "average from the start": with_train(JOINT, weight_average=1.0),
}


def setup(config: Config, lazy: bool | None, region: Region | None = None) -> Setup:
    renderer = make_renderer("cpu")
    return Setup(street(), config, renderer, FilePacker(), region=region, lazy=lazy)


def never() -> bool:
    return False


def stop_after(asks: int) -> Callable[[], bool]:
    left = iter(range(asks))
    return lambda: next(left, None) is None


def trained(of: Setup, folder: Path) -> TrainState:
    folder.mkdir()
    state = open_state(of, folder, Silent())
    assert run_training(state, folder, Silent(), never)
    return state


def assert_same(found: dict[str, Tensor], expected: dict[str, Tensor]) -> None:
    assert found.keys() == expected.keys()
    assert [name for name, value in expected.items() if not torch.equal(found[name], value)] == []


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Of every pass of learning over some of the rows, which share of all it read."""
    shares: list[float] = []
    inner = LazyRows.near

    def noted(self: LazyRows, *args: Any) -> RowsNear:
        near = inner(self, *args)
        shares.append(len(near.rows) / len(args[1]))
        return near

    monkeypatch.setattr(LazyRows, "near", noted)
    return shares


@pytest.mark.parametrize("name", CONFIGS)
def test_a_training_and_its_moments_are_the_same_bits(
    name: str, tmp_path: Path, seen: list[float]
) -> None:
    dense = trained(setup(CONFIGS[name], lazy=False), tmp_path / "dense")
    assert not seen
    lazy = trained(setup(CONFIGS[name], lazy=True), tmp_path / "lazy")
    assert_same(lazy.model.state_dict(), dense.model.state_dict())
    assert lazy.cursor.loss == dense.cursor.loss > 0
    # The street is long: if most of it were read, nothing would be late.
    assert (not seen) == (name == "fusion MLP")
    assert not seen or np.mean(seen) < 0.4


@pytest.mark.parametrize("asks", [7, 33, 44])
def test_a_checkpoint_holds_the_same_bits_and_goes_on_with_either(
    asks: int, tmp_path: Path
) -> None:
    folders = [tmp_path / "dense", tmp_path / "lazy", tmp_path / "mixed"]
    for folder, lazy in zip(folders, (False, True, True), strict=True):
        folder.mkdir()
        state = open_state(setup(JOINT, lazy), folder, Silent())
        assert not run_training(state, folder, Silent(), stop_after(asks))
    dense, lazy = (load_file(folder / CHECKPOINT) for folder in folders[:2])
    assert sum(name.startswith("adam.") for name in dense) > 20
    assert_same(lazy, dense)
    ends = []
    for folder, lazily in zip(folders, (False, True, False), strict=True):
        state = open_state(setup(JOINT, lazily), folder, Silent())
        assert run_training(state, folder, Silent(), never)
        ends.append(state.model.state_dict())
    assert_same(ends[1], ends[0])
    assert_same(ends[2], ends[0])


@pytest.mark.parametrize(("anchors", "share", "lazy"), [(300, 0.5, True), (300, 0.01, False)])
def test_it_is_chosen_where_many_anchors_are_out_of_view(
    anchors: int, share: float, lazy: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    phase = phases_of(JOINT)[0]
    state = open_state(setup(JOINT, None), tmp_path, Silent())
    assert len(state.model) > anchors
    state.start(phase.make_optimiser(state))
    assert state.optimiser.lazy is None  # few anchors
    monkeypatch.setattr(of_state, "LAZY_ANCHORS", anchors)
    monkeypatch.setattr(of_state, "LAZY_SHARE", share)
    state.start(phase.make_optimiser(state))
    assert (state.optimiser.lazy is not None) == lazy


def test_a_block_is_the_same_bits(tmp_path: Path, seen: list[float]) -> None:
    region = Region(low=(-7.0, -9.0, -9.0), high=(3.0, 9.0, 9.0))
    dense, lazy = (
        trained(setup(CONFIGS["tied"], lazy, region), tmp_path / str(lazy))
        for lazy in (False, True)
    )
    assert_same(lazy.model.state_dict(), dense.model.state_dict())
    moving = lazy.moving()
    assert seen and moving is not None and 0 < int(moving.sum()) < len(moving)


@pytest.fixture(params=_core.variants())
def variant(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    for name in ("adam", "adam_rows", "catch_up", "bound_rows", "rows_near", "visible_rows"):
        monkeypatch.setattr(_core, name, partial(getattr(_core, name), variant=request.param))
    return request.param


def parameters(rows: int) -> dict[str, nn.Parameter]:
    g = torch.Generator().manual_seed(1)
    shapes = {"wide": (rows, 5, 7), "narrow": (rows, 3)}
    made = {n: nn.Parameter(torch.randn(shape, generator=g)) for n, shape in shapes.items()}
    with torch.no_grad():
        made["wide"][:, 0] = 0  # a weight of zero is moved by however little
        made["narrow"][::2] *= 1e-6
    return made


def pair(rows: int) -> tuple[Optimiser, Optimiser, LazyRows]:
    dense, late = Optimiser(parameters(rows), RATES), Optimiser(parameters(rows), RATES)
    late.make_lazy(list(RATES))
    assert late.lazy is not None
    return dense, late, late.lazy


def send(dense: Optimiser, lazy: LazyRows, rows: Tensor, names: tuple[str, ...], seed: int) -> None:
    """The same gradients of some rows to both, by size as different as they come."""
    g, values = torch.Generator().manual_seed(seed), {}
    for name in names:
        parameter = dense.parameter(name)
        scale = 10.0 ** torch.randint(-24, 3, (len(rows), *[1] * (parameter.ndim - 1)), generator=g)
        values[name] = torch.randn(len(rows), *parameter.shape[1:], generator=g) * scale
        parameter.grad = torch.zeros_like(parameter)
        parameter.grad[rows] = values[name]
    lazy.give([RowGradients(rows, values)], 1)


@pytest.mark.parametrize("rows", [1, 3, 40])
@pytest.mark.parametrize("averaged", [False, True])
def test_rows_out_of_sight_for_thousands_of_steps_end_where_the_dense_step_puts_them(
    rows: int, averaged: bool, variant: str
) -> None:
    if averaged and "baseline" in variant and torch.backends.cpu.get_cpu_capability() != "DEFAULT":
        pytest.skip("PyTorch multiplies and adds in one rounding here, as the other variants do")
    dense, late, lazy = pair(rows)
    g = torch.Generator().manual_seed(7)
    for step in range(3000):
        if step < 30 or step % 700 < 2:
            some = (torch.rand(rows, generator=g) > 0.6).nonzero()[:, 0]
            names = ("wide", "narrow") if step % 3 else ("wide",)
            send(dense, lazy, some, names, step)
        else:  # a step in which nothing is seen moves everything
            send(dense, lazy, torch.zeros(0, dtype=torch.int64), ("wide", "narrow"), step)
        for optimiser in (dense, late):
            optimiser.set_progress(step / 3000)
            optimiser.step()
            if averaged and step >= 1990:
                optimiser.average(1 / (step - 1989))
    assert_same(late.tensors(), dense.tensors())
    for name in RATES:
        assert torch.equal(late.parameter(name), dense.parameter(name)), name
        assert not torch.equal(late.parameter(name), parameters(rows)[name])


def test_a_row_is_late_until_it_is_read(variant: str) -> None:
    dense, late, lazy = pair(4)
    for step in range(3):
        send(dense, lazy, torch.tensor([0, 1]) if step == 0 else torch.tensor([2]), ("wide",), step)
        dense.step()
        late.step()
    out_of_date = (late.parameter("wide") != dense.parameter("wide")).flatten(1).any(dim=1)
    assert out_of_date.tolist() == [True, True, False, False]
    late.settle()
    assert torch.equal(late.parameter("wide"), dense.parameter("wide"))


def narrow_view() -> tuple[AnchorModel, Camera]:
    """A model, and a camera that sees the middle of it."""
    model = tiny_model()
    with torch.no_grad():
        model.offsets.mul_(0.2)
        model.log_scales.sub_(2)
    camera = look_at(np.array([0.0, 0.0, -4.0]), np.zeros(3), 24, 16)
    return model, replace(camera, fx=400.0, fy=400.0)


def test_rows_that_come_into_view_by_their_momentum_were_near_all_along(variant: str) -> None:
    model, camera = narrow_view()
    rates = {"offsets": (0.05, 0.05), "log_scales": (0.05, 0.05)}
    values = {name: getattr(model, name) for name in ROW_PARAMETERS}
    optimiser = Optimiser({name: values[name] for name in rates}, rates)
    g = torch.Generator().manual_seed(3)
    for name in rates:
        values[name].grad = torch.randn(values[name].shape, generator=g)
    optimiser.step()
    optimiser.make_lazy(list(rates))
    lazy, x = optimiser.lazy, model.placed()[0]
    assert lazy is not None
    nothing = RowGradients(torch.zeros(0, dtype=torch.int64), {})
    nothing.values.update({name: values[name].detach()[:0] for name in rates})
    lazy.give([nothing], 1)
    optimiser.step()  # the rates are known from here on
    near = set(lazy.near(values, x, camera, 1.0).rows.tolist())
    optimiser.settle()
    first = set(model.visible(model.part(-1), camera).tolist())
    came: set[int] = set()
    for _ in range(80):
        lazy.take()
        for name in rates:
            values[name].grad = torch.zeros_like(values[name])
        optimiser.step()
        came |= set(model.visible(model.part(-1), camera).tolist()) - first
    assert came and came | first <= near < set(range(len(model)))


def test_a_rate_that_rises_makes_the_bounds_anew() -> None:
    model, camera = narrow_view()
    values = {name: getattr(model, name) for name in ROW_PARAMETERS}
    optimiser = Optimiser({"offsets": values["offsets"]}, {"offsets": (1e-6, 1e-6)})
    values["offsets"].grad = torch.ones_like(values["offsets"])
    optimiser.step()
    optimiser.make_lazy(["offsets"])
    lazy, x = optimiser.lazy, model.placed()[0]
    assert lazy is not None
    counts = []
    for factor in (1.0, 1.0, 1e6):
        none = {"offsets": values["offsets"].detach()[:0]}
        lazy.give([RowGradients(torch.zeros(0, dtype=torch.int64), none)], 1)
        optimiser.set_progress(0, factor)
        optimiser.step()
        counts.append(len(lazy.near(values, x, camera, 1.0).rows))
        lazy.take()
    assert counts[0] == counts[1] < counts[2]


def test_gradients_of_two_cameras_in_one_step_add_up() -> None:
    states = [open_state(setup(JOINT, lazy), Path("nowhere"), Silent()) for lazy in (False, True)]
    totals = []
    for state in states:
        state.start(Optimiser({n: getattr(state.model, n) for n in RATES_OF_ROWS}, RATES_OF_ROWS))
        for view in (1, 4, 9, 1):
            state.study(state.model.part(-1), view, 1.0)
        found = None if state.optimiser.lazy is None else state.optimiser.lazy.take()
        grads = {n: getattr(state.model, n).grad for n in RATES_OF_ROWS}
        if found is not None:
            assert all(grad is None for grad in grads.values())
            grads = {n: torch.zeros_like(getattr(state.model, n)) for n in RATES_OF_ROWS}
            for name, grad in grads.items():
                grad[found.rows] = found.values[name]
        totals.append(grads)
    assert_same(totals[1], totals[0])
    assert float(totals[0]["offsets"].abs().max()) > 0
