"""What a CUDA device runs, against the CPU's native pieces: plain PyTorch, gsplat or its oracle.

Without a device the same code runs on the CPU (`plain`); with one, `pytest -m gpu` runs it there.
The rasteriser alone is in `tests/render/test_cuda.py`.
"""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from gsynopsis.jobs.write_file import FilePacker
from gsynopsis.model import anchors, decode
from gsynopsis.model.anchors import AnchorModel
from gsynopsis.model.decode import assemble_reference, heads_reference, visible_rows_reference
from gsynopsis.model.encoding import grid_features_indexed
from gsynopsis.model.tables import Decoded
from gsynopsis.render import cuda
from gsynopsis.render.base import Renderer
from gsynopsis.render.choose import make_renderer
from gsynopsis.render.cuda import CudaRenderer
from gsynopsis.training import view_step
from gsynopsis.training.context import TrainContext
from gsynopsis.training.growth import GrowthStatistics
from gsynopsis.training.loop import open_state, run_training
from gsynopsis.training.losses import (
    mean_squared_reference,
    photometric_reference,
    unit_pixels_reference,
    volume_reference,
)
from gsynopsis.training.observer import Silent
from gsynopsis.training.optim import adam as optimizer
from gsynopsis.training.state import TrainState, fresh_state
from gsynopsis.training.view_step import count_view, photometric_loss, volume_loss
from tests.devices import CUDA
from tests.render import gsplat_twin
from tests.tiny import tiny_config, tiny_model, tiny_scene

VIEW = 3
LIMIT = 1e-3
"""Of gradients, relative to the largest of their tensor."""


@pytest.fixture(params=["plain", CUDA])
def renderer(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Renderer:
    """Of a CUDA device; `plain` is all that it runs, on the CPU, over gsplat's plain twin."""
    return make_renderer("cuda") if request.param == "cuda" else plain_renderer(monkeypatch)


def plain_renderer(monkeypatch: pytest.MonkeyPatch) -> Renderer:
    """Takes the roads of CUDA on the CPU."""
    monkeypatch.setattr(anchors, "compute_heads", heads_reference)
    monkeypatch.setattr(anchors, "assemble", assemble_reference)
    monkeypatch.setattr(anchors, "native_rows", visible_rows_reference)
    monkeypatch.setattr(decode, "grid_features", grid_features_indexed)
    monkeypatch.setattr(view_step, "photometric_loss", photometric_reference)
    monkeypatch.setattr(view_step, "volume_loss", volume_reference)
    monkeypatch.setattr(view_step, "mean_squared_error", mean_squared_reference)
    monkeypatch.setattr(view_step, "unit_pixels", unit_pixels_reference)
    monkeypatch.setattr(optimizer, "_is_plain", lambda _: False)
    monkeypatch.setattr(cuda, "_import_gsplat", lambda: gsplat_twin.rasterization)
    return CudaRenderer("cpu")


def near(found: Tensor, expected: Tensor, limit: float = LIMIT) -> bool:
    """Within a share of the largest entry."""
    scale = max(float(expected.abs().max()), 1e-12)
    return float((found.detach().cpu() - expected).abs().max()) <= limit * scale


def decoded(model: AnchorModel) -> tuple[Decoded, dict[str, Tensor]]:
    """The Gaussians of a view, and gradients of a sum of all their values by everything learnt."""
    found = model.decode_level(-1, tiny_scene().camera(VIEW))
    g = found.gaussians
    total = g.means.new_zeros(())
    for number, values in enumerate((g.means, g.quats, g.scales, g.opacities, g.colors)):
        generator = torch.Generator().manual_seed(number)
        total = total + (values * torch.rand(values.shape, generator=generator).to(values)).sum()
    total.backward()
    learnt = {name: p.grad for name, p in model.named_parameters() if p.numel()}
    return found, {name: grad for name, grad in learnt.items() if grad is not None}


@pytest.fixture
def expected() -> tuple[Decoded, dict[str, Tensor]]:
    """Of the native pieces: asked for before `renderer`, which puts others in their places."""
    return decoded(tiny_model())


def test_heads_and_assembly(
    expected: tuple[Decoded, dict[str, Tensor]], renderer: Renderer
) -> None:
    native, native_gradients = expected
    found, gradients = decoded(tiny_model().to(renderer.device))
    assert torch.equal(found.anchors.cpu(), native.anchors)
    assert torch.equal(found.slots.cpu(), native.slots) and len(native.slots) > 100
    for name in ("means", "quats", "scales", "opacities", "colors"):
        assert near(getattr(found.gaussians, name), getattr(native.gaussians, name).detach(), 1e-5)
    assert near(found.opacity, native.opacity.detach(), 1e-5)
    assert gradients.keys() == native_gradients.keys() and len(gradients) > 10
    for name, gradient in gradients.items():
        assert near(gradient, native_gradients[name]), name


def observed(model: AnchorModel, own: Renderer) -> GrowthStatistics:
    """What growth counts in three views."""
    statistics = GrowthStatistics.zeros(len(model), model.slots, own.device)
    scene = tiny_scene()
    for view in scene.train[:3]:
        cam = scene.camera(view)
        found = model.decode_level(-1, cam)
        rendering = own.render(found.gaussians, cam, torch.zeros(3, device=own.device))
        rendering.image.square().sum().backward()
        count_view(statistics, found, rendering)
    return statistics


@pytest.fixture
def counted() -> GrowthStatistics:
    return observed(tiny_model(), make_renderer("cpu"))


def test_growth_statistics(counted: GrowthStatistics, renderer: Renderer) -> None:
    found = observed(tiny_model().to(renderer.device), renderer)
    for name in ("gradient", "opacity", "visits"):
        assert near(getattr(found, name), getattr(counted, name), 5e-3), name
    # gsplat counts by radii: also a few whose circle meets the image while no pixel shows them.
    other = found.drawn.cpu() != counted.drawn
    assert bool((found.drawn.cpu() >= counted.drawn).all()) and float(other.double().mean()) < 0.02
    assert float(counted.gradient.max()) > 0


def test_losses(renderer: Renderer) -> None:
    generator = torch.Generator().manual_seed(0)
    image = torch.rand(33, 47, 3, generator=generator)
    target = (image + 0.1 * torch.randn(33, 47, 3, generator=generator)).clamp(0, 1)
    scales = torch.rand(500, 3, generator=generator)
    for native, other, values in (
        (lambda x: photometric_loss(x, target, 0.2), _compared(target, renderer), image),
        (volume_loss, volume_reference, scales),
    ):
        a, b = values.clone().requires_grad_(), values.to(renderer.device).requires_grad_()
        first, second = native(a), other(b)
        first.backward()
        second.backward()
        assert float(second.detach()) == pytest.approx(float(first.detach()), rel=1e-5)
        assert a.grad is not None and b.grad is not None and near(b.grad, a.grad)


def _compared(target: Tensor, renderer: Renderer):
    moved = target.to(renderer.device)
    return lambda x: photometric_reference(x, moved, 0.2)


def trained(renderer: Renderer, out: Path, steps: int, *stops: int) -> TrainState:
    """A training of so many steps of both phases, stopped after some and gone on with."""
    out.mkdir(exist_ok=True)
    config = tiny_config(steps=steps // 5)
    config = replace(config, train=replace(config.train, steps=steps - steps // 5))
    context = TrainContext(tiny_scene(), config, renderer, FilePacker())

    def until(stop: int) -> TrainState:
        found, asked = open_state(context, out, Silent()), iter(range(stop))
        run_training(found, out, Silent(), lambda: next(asked) + 1 >= stop, 1e9)
        return found

    for stop in stops:
        until(stop)
    return until(10**9)


def steps_for(renderer: Renderer) -> int:
    """300 on a device; the oracle on the CPU takes a tenth of a second for each."""
    return 300 if renderer.device.type == "cuda" else 50


@pytest.fixture
def native(tmp_path: Path) -> dict[int, float]:
    """PSNR of trainings of the native pieces, by their steps."""
    return {n: trained(make_renderer("cpu"), tmp_path / f"{n}", n).progress.psnr for n in (50, 300)}


def test_a_training(native: dict[int, float], renderer: Renderer, tmp_path: Path) -> None:
    steps = steps_for(renderer)
    begun = len(fresh_state(TrainContext(tiny_scene(), tiny_config(), renderer)).model)
    found = trained(renderer, tmp_path / "run", steps)
    assert found.model.offsets.device.type == renderer.device.type and len(found.model) != begun
    limit = 1.0 if steps == 300 else 0.05
    assert found.progress.psnr == pytest.approx(native[steps], abs=limit)
    assert native[300] > native[50] + 1


def test_a_training_goes_on_where_it_was_stopped(renderer: Renderer, tmp_path: Path) -> None:
    steps = steps_for(renderer)
    whole = trained(renderer, tmp_path / "whole", steps)
    parts = trained(renderer, tmp_path / "parts", steps, steps // 3, steps // 2)
    if renderer.device.type == "cuda":  # sums are in no fixed order there
        assert parts.progress.psnr == pytest.approx(whole.progress.psnr, abs=1.0)
        return
    for name, value in whole.model.state_dict().items():
        assert torch.equal(parts.model.state_dict()[name], value), name
