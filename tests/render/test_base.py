import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from gsynopsis._native import _core
from gsynopsis.render.base import Gaussians, Renderer, low_pass_filter
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.render.cuda import opacity_compensation
from gsynopsis.render.measures import (
    blend_weights,
    removal_effects,
    render_depth,
    sampled_removal_effects,
)
from gsynopsis.render.reference import ReferenceRenderer, blend, pixel_alphas, project
from gsynopsis.scene.camera import Camera
from tests.render.raster_scenes import BACKGROUND, camera, random_scene

RENDERERS = [CpuRenderer(), ReferenceRenderer()]


def direct_weights(scene: Gaussians, cam) -> torch.Tensor:
    """Blend weights [G, H W] straight from the definition, in input order."""
    projected = project(scene, cam)
    alphas = pixel_alphas(projected, scene.opacities[projected.index], cam)
    order = torch.argsort(projected.depths, stable=True)
    weights, _ = blend(alphas[order])
    out = torch.zeros(len(scene), cam.width * cam.height, dtype=weights.dtype)
    out[projected.index[order]] = weights
    return out


@pytest.mark.parametrize("renderer", RENDERERS, ids=lambda r: r.name)
def test_blend_weights_are_those_of_the_definition(renderer: Renderer) -> None:
    cam = camera(60, 40)
    scene = random_scene(150, cam)
    weights = blend_weights(renderer, scene, cam)
    assert torch.allclose(weights.double(), direct_weights(scene, cam).sum(1), atol=1e-3)


@pytest.mark.parametrize("renderer", RENDERERS, ids=lambda r: r.name)
def test_blend_weights_add_up_to_the_alpha_of_the_image(renderer: Renderer) -> None:
    cam = camera(60, 40)
    scene = random_scene(300, cam, sigma=4)
    alpha = renderer.render(scene, cam, BACKGROUND).alpha
    total = blend_weights(renderer, scene, cam).double().sum()
    assert abs(total - alpha.double().sum()) < 1e-5 * total


def changes_without(renderer: Renderer, scene: Gaussians, cam: Camera) -> Tensor:
    """The oracle of removal effects: draw without each Gaussian, float64 [G]."""
    whole = renderer.render(scene, cam, BACKGROUND).image
    changes = torch.zeros(len(scene), dtype=torch.float64)
    for number in range(len(scene)):
        opacities = scene.opacities.clone()
        opacities[number] = 0
        without = renderer.render(replace(scene, opacities=opacities), cam, BACKGROUND).image
        changes[number] = (whole - without).double().square().sum()
    return changes


@pytest.mark.parametrize("renderer", RENDERERS, ids=lambda r: r.name)
def test_removal_effects_are_what_leaving_out_changes(renderer: Renderer) -> None:
    """Estimates have no bias, so their mean comes close."""
    cam = camera(40, 30)
    scene = random_scene(30, cam, sigma=4)
    chance, count = torch.Generator().manual_seed(1), 200
    found = torch.stack(
        [sampled_removal_effects(renderer, scene, cam, BACKGROUND, chance) for _ in range(count)]
    ).double()
    exact, error = changes_without(renderer, scene, cam), found.std(dim=0) / count**0.5
    assert ((found.mean(dim=0) - exact).abs() <= 4.5 * error + 0.02 * exact + 1e-6).all()


@pytest.mark.parametrize("variant", _core.variants())
@pytest.mark.parametrize("opaque", [0.4, 1.0])
def test_the_cpu_s_removal_effects_are_exact(variant: str, opaque: float) -> None:
    """Also where alpha is capped, and at the edges of tiles and of the image."""
    cam, renderer = camera(75, 50), CpuRenderer(variant=variant)
    scene = random_scene(60, cam, sigma=4, opaque=opaque)
    found = removal_effects(renderer, scene, cam, BACKGROUND, torch.Generator())
    exact = changes_without(renderer, scene, cam)
    assert exact.max() > 1
    assert torch.allclose(found.double(), exact, rtol=2e-3, atol=1e-4)


def test_the_cpu_s_removal_effects_are_the_same_bits_for_any_number_of_threads() -> None:
    cam = camera(200, 150)
    scene, chance = random_scene(5000, cam), torch.Generator()
    one, three = (
        removal_effects(CpuRenderer(threads), scene, cam, BACKGROUND, chance) for threads in (1, 3)
    )
    assert torch.equal(one, three)
    assert one.any()


@pytest.mark.parametrize("renderer", RENDERERS, ids=lambda r: r.name)
def test_depth_is_the_mean_z_by_blend_weight(renderer: Renderer) -> None:
    cam = camera(60, 40)
    scene = random_scene(150, cam)
    weights = direct_weights(scene, cam)
    w2c = torch.tensor(cam.w2c)
    z = scene.means @ w2c[2, :3] + w2c[2, 3]
    alpha = weights.sum(0)
    expected = torch.where(alpha > 1e-3, (weights.T @ z) / alpha, torch.zeros(()))
    depth = render_depth(renderer, scene, cam)
    assert torch.allclose(depth.double().flatten(), expected, atol=2e-3)


@pytest.mark.parametrize("renderer", RENDERERS, ids=lambda r: r.name)
def test_a_single_gaussian_has_its_own_depth(renderer: Renderer) -> None:
    cam = camera(60, 40)
    scene = random_scene(1, cam, seed=2, opaque=0.3)
    z = (scene.means @ torch.tensor(cam.w2c[2, :3]) + cam.w2c[2, 3]).item()
    depth = render_depth(renderer, scene, cam)
    assert depth.max() == pytest.approx(z, rel=1e-4)


def test_no_gaussians_have_no_weights_and_no_depth() -> None:
    cam = camera(20, 10)
    scene = random_scene(0, cam)
    for renderer in RENDERERS:
        assert blend_weights(renderer, scene, cam).shape == (0,)
        assert not render_depth(renderer, scene, cam).any()
        chance = torch.Generator()
        assert removal_effects(renderer, scene, cam, BACKGROUND, chance).shape == (0,)


def test_training_adds_the_same_to_every_picture_of_its_own_size() -> None:
    cam = camera(60, 40)
    length = math.sqrt(cam.fx * cam.fy)
    scene = random_scene(1, cam)
    assert low_pass_filter(scene.focals, cam.focal_length) == (0.3, 0.3)
    for focals in [(length, length), (0.5 * length, 2 * length)]:
        assert low_pass_filter(focals, cam.focal_length) == (0.3, 0.3)
    half = replace(scene, focals=(2 * length, 3 * length))
    assert low_pass_filter(half.focals, cam.focal_length) == pytest.approx((0.075, 0.3))
    double = replace(scene, focals=(0.25 * length, 0.5 * length))
    assert low_pass_filter(double.focals, cam.focal_length) == pytest.approx((1.2, 1.2))


@pytest.mark.parametrize("renderer", RENDERERS, ids=lambda r: r.name)
def test_a_larger_picture_shows_the_same_in_more_pixels(renderer: Renderer) -> None:
    cam = camera(60, 40)
    length = math.sqrt(cam.fx * cam.fy)
    scene = replace(random_scene(150, cam, sigma=0.3), focals=(length, length))
    small = renderer.render(scene, cam, BACKGROUND).image
    large = renderer.render(scene, cam.scaled(0.25), BACKGROUND).image
    # Both sample the same function: four by four samples, to the one in their middle.
    middle = large.reshape(40, 4, 60, 4, 3)[:, 1:3, :, 1:3].mean(dim=(1, 3))
    as_before = renderer.render(replace(scene, focals=None), cam.scaled(0.25), BACKGROUND).image
    thinner = as_before.reshape(40, 4, 60, 4, 3)[:, 1:3, :, 1:3].mean(dim=(1, 3))
    assert (middle - small).square().mean() < 0.05 * (thinner - small).square().mean()


@pytest.mark.parametrize("renderer", RENDERERS, ids=lambda r: r.name)
def test_a_smaller_picture_is_the_mean_of_the_pixels_of_a_large_one(renderer: Renderer) -> None:
    cam = camera(120, 80)
    length = math.sqrt(cam.fx * cam.fy)
    # Few, so that they hardly lie on each other: blending is not linear.
    scene = replace(random_scene(30, cam, sigma=0.7), focals=(length, length))
    scene = replace(scene, opacities=0.5 + 0.4 * scene.opacities)
    black = torch.zeros(3)
    large = renderer.render(scene, cam, black).image
    expected = large.reshape(20, 4, 30, 4, 3).mean(dim=(1, 3)).sum()
    small = renderer.render(scene, cam.scaled(4), black).image.sum()
    thick = renderer.render(replace(scene, focals=None), cam.scaled(4), black).image.sum()
    assert small == pytest.approx(float(expected), rel=0.1)
    assert thick > 3 * expected


def test_the_factors_for_gsplat_are_those_of_the_reference() -> None:
    cam = camera(60, 40)
    scene = random_scene(150, cam, sigma=0.5)
    scene = replace(scene, focals=(4 * cam.fx, 5 * cam.fx))
    projected = project(scene, cam)
    found = opacity_compensation(scene, cam)
    assert isinstance(found, torch.Tensor)
    assert torch.allclose(found[projected.index], projected.fade)
    assert 0.05 < found.min() < found.max() < 1
    assert opacity_compensation(replace(scene, focals=None), cam) == 1
