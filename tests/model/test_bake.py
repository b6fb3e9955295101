"""Baking: averages and fits that are right where the right answer is known."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.nn import functional

from gsynopsis.model.bake import (
    Baking,
    bake,
    from_log_covariances,
    log_covariances,
    quaternions,
    rotations,
)
from gsynopsis.model.plain import PlainModel
from gsynopsis.render.choose import make_renderer
from tests.tiny import tiny_model, tiny_scene

SCENE = tiny_scene()
CAMERAS = [SCENE.camera(view) for view in SCENE.train]


def still_model(*, colors: bool = True):
    """A tiny model whose heads do not look at the view: shapes and opacities, or all."""
    model = tiny_model()
    networks = model.part(-1).networks
    with torch.no_grad():
        for head in ("opacity", "cov", *(("color",) if colors else ())):
            networks[f"{head}_w1"][:, -4:] = 0
    return model


def baked_picture(model, camera, baking: Baking) -> torch.Tensor:
    renderer = make_renderer("cpu")
    gaussians = bake(model, -1, CAMERAS, renderer, baking)
    plain = PlainModel(gaussians, antialiased=baking.antialiased)
    with torch.no_grad():
        return renderer.render(plain.decode(camera), camera, torch.zeros(3)).image


@pytest.mark.parametrize("degree", [0, 3])
def test_what_does_not_depend_on_the_view_is_baked_exactly(degree: int) -> None:
    model, camera = still_model(), CAMERAS[2]
    with torch.no_grad():
        truth = make_renderer("cpu").render(model.decode(camera), camera, torch.zeros(3)).image
    assert float((baked_picture(model, camera, Baking(degree)) - truth).abs().max()) < 2e-3


def test_higher_degrees_follow_colours_of_the_view_more_closely() -> None:
    model = still_model(colors=False)
    renderer, errors = make_renderer("cpu"), []
    for degree in (0, 1, 3):
        plain = PlainModel(bake(model, -1, CAMERAS, renderer, Baking(degree)), antialiased=False)
        total = 0.0
        for camera in CAMERAS:
            with torch.no_grad():
                pair = [m.decode(camera) for m in (model, plain)]
                truth, image = (renderer.render(g, camera, torch.zeros(3)).image for g in pair)
            total += float((image - truth).square().mean())
        errors.append(total)
    assert errors[0] > 1.5 * errors[1] > 1.5 * errors[2]


def test_slots_that_no_camera_sees_are_dropped() -> None:
    model = still_model()
    renderer = make_renderer("cpu")
    some = bake(model, -1, CAMERAS, renderer, Baking(1))
    assert 0 < len(some) < int(model.part(-1).mask.sum())
    back = np.diag([-1.0, 1.0, -1.0, 1.0])
    away = replace(CAMERAS[0], w2c=back @ CAMERAS[0].w2c)
    assert len(bake(model, -1, [away], renderer, Baking(1))) == 0


def test_baking_changes_nothing_of_the_model() -> None:
    model = tiny_model()
    before = {name: value.clone() for name, value in model.state_dict().items()}
    bake(model, -1, CAMERAS, make_renderer("cpu"), Baking(2))
    assert all(torch.equal(value, before[name]) for name, value in model.state_dict().items())


def test_a_covariance_comes_back_from_its_logarithm() -> None:
    chance = torch.Generator().manual_seed(3)
    quats = torch.randn(50, 4, generator=chance)
    scales = (torch.randn(50, 3, generator=chance) * 1.5 - 3).exp()
    added = torch.rand(50, generator=chance) * 1e-3
    turned, logs = from_log_covariances(log_covariances(quats, scales, added))

    def covariance(turn: torch.Tensor, squares: torch.Tensor) -> torch.Tensor:
        axes = rotations(turn)
        return (axes * squares[:, None]) @ axes.transpose(1, 2)

    found = covariance(turned, (2 * logs).exp())
    truth = covariance(quats, scales.square() + added[:, None])
    scale = truth.abs().amax(dim=(1, 2), keepdim=True)
    assert float(((found - truth) / scale).abs().max()) < 1e-4


def test_quaternions_are_those_of_their_rotations() -> None:
    chance = torch.Generator().manual_seed(4)
    quats = functional.normalize(torch.randn(200, 4, generator=chance, dtype=torch.float64), dim=1)
    half_turns = torch.eye(4, dtype=torch.float64)
    quats = torch.cat([quats, half_turns])
    found = quaternions(rotations(quats))
    assert float((found * quats).sum(dim=1).abs().min()) > 1 - 1e-12


def test_antialiased_gaussians_look_alike_in_a_larger_picture() -> None:
    """There training's dilation is part of the level's Gaussians, and of those baked so alone."""
    model, camera = still_model(), CAMERAS[3].scaled(1 / 6)
    lengths = [c.fx for c in CAMERAS]
    model.part(-1).focals = (min(lengths), max(lengths))
    with torch.no_grad():
        truth = make_renderer("cpu").render(model.decode(camera), camera, torch.zeros(3)).image
    errors = [
        float((baked_picture(model, camera, Baking(1, flag)) - truth).square().mean())
        for flag in (True, False)
    ]
    assert errors[0] < 0.2 * errors[1]


def test_a_splat_so_flat_that_its_variance_is_nothing_keeps_its_other_axes() -> None:
    scales = torch.tensor([[0.5, 0.2, 6e-37]])
    quats = functional.normalize(torch.tensor([[0.9, 0.1, -0.3, 0.2]]), dim=1)
    _, logs = from_log_covariances(log_covariances(quats, scales, torch.zeros(1)))
    assert torch.allclose(logs[0].sort().values[1:].exp(), torch.tensor([0.2, 0.5]), rtol=1e-3)
