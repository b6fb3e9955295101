"""The CUDA rasteriser against the oracle: its own code on the CPU, over gsplat's plain twin."""

from dataclasses import replace
from importlib import import_module

import pytest
import torch

from gsynopsis.render import cuda
from gsynopsis.render.base import ANTIALIASED, Gaussians, Renderer
from gsynopsis.render.cuda import CudaRenderer
from gsynopsis.render.reference import ReferenceRenderer
from tests.devices import DEVICES
from tests.render import gsplat_twin
from tests.render.raster_scenes import (
    BACKGROUND,
    FIELDS,
    camera,
    hand_scene,
    loss_weights,
    random_scene,
    run,
    safe_pixels,
)

# Its principal point is near the centre: gsplat measures the Jacobian's clamp from the edges.
CAMERA = replace(camera(48, 40), cx=24.4, cy=19.7)


@pytest.fixture(params=DEVICES)
def renderer(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Renderer:
    if request.param == "cpu":
        monkeypatch.setattr(cuda, "_import_gsplat", lambda: gsplat_twin.rasterization)
    return CudaRenderer(request.param)


def on(renderer: Renderer, scene: Gaussians) -> Gaussians:
    moved = {name: getattr(scene, name).to(renderer.device) for name in FIELDS}
    return replace(scene, **moved)


# Opacities stay below the caps, 0.99 here and 0.999 in gsplat.
SCENES = {
    "random": random_scene(120, CAMERA, seed=6),
    "thick": random_scene(150, CAMERA, seed=7, sigma=8),
    "by hand": replace(hand_scene(CAMERA), opacities=hand_scene(CAMERA).opacities.clamp(max=0.95)),
    "of larger photos": random_scene(120, CAMERA, seed=8),
    "antialiased": random_scene(120, CAMERA, seed=9, sigma=0.4),
}
FOCALS = {"of larger photos": (300.0, 400.0), "antialiased": ANTIALIASED}


@pytest.mark.parametrize("name", SCENES)
def test_images_and_gradients_are_those_of_the_oracle(name: str, renderer: Renderer) -> None:
    scene = replace(SCENES[name], focals=FOCALS.get(name))
    weights, safe = loss_weights(scene, CAMERA), safe_pixels(scene, CAMERA)
    oracle = run(ReferenceRenderer(), scene, CAMERA, weights, torch.float64)
    found = run(renderer, on(renderer, scene), CAMERA, weights.to(renderer.device))
    difference = (found.image.cpu() - oracle.image).abs().amax(dim=2)
    assert float(difference[safe].max()) < 2e-4 and float(safe.double().mean()) > 0.5
    for field in (*FIELDS, "background"):
        grad, wanted = found.grads[field].cpu(), oracle.grads[field]
        assert float((grad - wanted).abs().max()) < 5e-3 * float(wanted.abs().max()), field
    screen = (found.screen.cpu() - oracle.screen).abs().max()
    assert float(screen) < 5e-3 * float(oracle.screen.abs().max())
    drawn = oracle.rendering.visible
    assert bool(found.rendering.visible.cpu()[drawn].all()) and bool(drawn.any())


def test_what_is_not_finite_is_not_drawn_and_has_no_gradient(renderer: Renderer) -> None:
    scene = on(renderer, random_scene(30, CAMERA, seed=2))
    freaks = {name: getattr(scene, name).float().clone() for name in FIELDS}
    freaks["means"][0], freaks["scales"][1, 0] = torch.nan, torch.inf
    freaks["quats"][2], freaks["opacities"][3], freaks["colors"][4, 1] = 0, torch.nan, -torch.inf
    leaves = {name: values.requires_grad_(True) for name, values in freaks.items()}
    rendering = renderer.render(Gaussians(**leaves), CAMERA, BACKGROUND.to(renderer.device))
    rendering.image.sum().backward()
    kept = Gaussians(*(getattr(scene, name)[5:].float() for name in FIELDS))
    expected = renderer.render(kept, CAMERA, BACKGROUND.to(renderer.device)).image
    assert torch.allclose(rendering.image, expected, atol=1e-6)
    assert not bool(rendering.visible[:5].any())
    for name, leaf in leaves.items():
        assert leaf.grad is not None and not bool(leaf.grad[:5].any()), name
        assert bool(torch.isfinite(leaf.grad).all()) and bool(leaf.grad.any()), name


def test_nothing_to_draw_is_the_background(renderer: Renderer) -> None:
    nothing = Gaussians(*(getattr(SCENES["random"], n)[:0].float() for n in FIELDS))
    leaves = [getattr(on(renderer, nothing), name).requires_grad_(True) for name in FIELDS]
    rendering = renderer.render(Gaussians(*leaves), CAMERA, BACKGROUND)
    rendering.image.sum().backward()
    assert torch.equal(rendering.image[3, 4].cpu(), BACKGROUND)
    assert rendering.screen_grad().shape == (0, 2)


def test_the_twin_projects_as_gsplat_does() -> None:
    pytest.importorskip("gsplat", reason="gsplat is not installed")
    theirs = import_module("gsplat.cuda._torch_impl")
    scene = replace(SCENES["thick"], means=SCENES["thick"].means * 2)  # some beyond the clamp
    covariances = gsplat_twin.covariances_of(scene.quats, scene.scales)
    w2c, k = torch.as_tensor(CAMERA.w2c), cuda._intrinsics(CAMERA).double()
    size = (CAMERA.width, CAMERA.height)
    assert torch.allclose(
        theirs._quat_scale_to_covar_preci(scene.quats, scene.scales)[0], covariances
    )
    _, centers, depths, conics, _ = theirs._fully_fused_projection(
        scene.means, covariances, w2c[None], k[None], *size, 0.3
    )
    mine = gsplat_twin.projected(scene.means, covariances, w2c, k, size, 0.3)
    assert torch.allclose(centers[0], mine[0]) and torch.allclose(depths[0], mine[3])
    assert torch.allclose(conics[0], mine[1])
