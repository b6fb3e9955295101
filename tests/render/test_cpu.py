from dataclasses import replace

import numpy as np
import pytest
import torch

from gsynopsis._native import _core
from gsynopsis.errors import SpaceError
from gsynopsis.render.base import Gaussians
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.render.reference import ReferenceRenderer
from gsynopsis.scene.camera import Camera
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

VARIANTS = _core.variants()


def scene_of(name: str) -> tuple[Gaussians, Camera]:
    if name == "hand":
        cam = camera(64, 40)
        return hand_scene(cam), cam
    sizes = {"odd": (67, 45), "one column": (1, 70), "one row": (70, 1), "one pixel": (1, 1)}
    cam = camera(*sizes.get(name, (80, 60)))
    if name == "dense":  # most pixels end: alphas up to the cap, forty deep
        return random_scene(300, cam, seed=3, sigma=8, opaque=1.0), cam
    if name == "tiny":  # smaller than a pixel, the dilation decides
        return random_scene(400, cam, seed=4, sigma=0.2), cam
    if name in ("smaller", "larger"):  # than the photos of training, by far
        scene = random_scene(300, cam, seed=14, sigma=0.5 if name == "smaller" else 2.5)
        times = 5 if name == "smaller" else 0.3
        return replace(scene, focals=(times * cam.fx, 1.1 * times * cam.fx)), cam
    if name == "large":  # every Gaussian touches every tile
        return random_scene(40, cam, seed=5, sigma=60), cam
    return random_scene(200, cam, seed=6), cam


SCENES = [
    "hand",
    "odd",
    "one column",
    "one row",
    "one pixel",
    "dense",
    "tiny",
    "large",
    "smaller",
    "larger",
]


def test_the_hand_tuned_scene_is_away_from_every_cut_off() -> None:
    scene, cam = scene_of("hand")
    assert safe_pixels(scene, cam).all()
    assert (ReferenceRenderer().render(scene, cam, BACKGROUND).alpha > 1 - 2e-4).any()


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", SCENES)
def test_image_and_gradients_are_those_of_the_reference(name: str, variant: str) -> None:
    scene, cam = scene_of(name)
    weights = loss_weights(scene, cam)
    safe = safe_pixels(scene, cam)
    assert safe.float().mean() > 0.9
    ours = run(CpuRenderer(variant=variant), scene, cam, weights)
    oracle = run(ReferenceRenderer(), scene, cam, weights, torch.float64)
    assert (ours.image - oracle.image)[safe].abs().max() < 1e-4
    assert (ours.rendering.alpha - oracle.rendering.alpha)[safe].abs().max() < 1e-4
    # Seen by the reference means touched by ours, which may touch a border for nothing.
    assert not (oracle.rendering.visible & ~ours.rendering.visible).any()
    for field, expected in [*oracle.grads.items(), ("screen", oracle.screen)]:
        found = ours.screen if field == "screen" else ours.grads[field]
        scale = expected.abs().max().clamp(min=1e-12)
        assert (found - expected).abs().max() / scale < 1e-3, field


@pytest.mark.parametrize("variant", VARIANTS)
def test_any_number_of_threads_and_any_run_give_the_same_bits(variant: str) -> None:
    cam = camera(133, 71)
    scene = random_scene(5000, cam, seed=7, sigma=3)
    weights = torch.ones(71, 133, 3)
    results = set()
    for threads in (1, 2, 3, 2, 5):
        found = run(CpuRenderer(threads, variant), scene, cam, weights)
        tensors = [found.image, found.rendering.alpha, found.rendering.visible, found.screen]
        tensors += [found.grads[name] for name in FIELDS]
        results.add(b"".join(t.numpy().tobytes() for t in tensors))
    assert len(results) == 1


def test_the_order_of_the_gaussians_does_not_matter() -> None:
    cam = camera(70, 50)
    scene = random_scene(300, cam, seed=8)
    weights = loss_weights(scene, cam)
    shuffle = torch.randperm(300, generator=torch.Generator().manual_seed(0))
    shuffled = Gaussians(*(getattr(scene, name)[shuffle] for name in FIELDS))
    one = run(CpuRenderer(), scene, cam, weights)
    other = run(CpuRenderer(), shuffled, cam, weights)
    assert torch.equal(one.image, other.image)
    for name in FIELDS:
        # A Gaussian's sums over its tiles do not depend on the others.
        assert torch.equal(one.grads[name][shuffle], other.grads[name])


def freaks() -> Gaussians:
    """One decent Gaussian, then hostile ones: those that must not be seen, those that may be."""
    cam = camera(40, 30)
    scene = random_scene(40, cam, seed=9)
    values = {name: getattr(scene, name).float() for name in FIELDS}
    nan, inf = float("nan"), float("inf")
    values["means"][1] = nan
    values["means"][2, 0] = inf
    values["quats"][3] = 0
    values["quats"][4, 2] = nan
    values["scales"][5, 1] = nan
    values["scales"][6] = inf
    values["scales"][7] = 1e30
    values["opacities"][8] = nan
    values["opacities"][9] = -inf
    values["opacities"][10] = -0.5
    values["opacities"][11] = inf
    values["colors"][12, 0] = nan
    values["means"][13] = torch.tensor(cam.position).float()  # on the camera
    values["means"][14] = torch.tensor(cam.position - cam.forward).float()  # behind it
    values["quats"][15] = 1e-30  # its square is zero in float32
    # From here on drawn or not, but harmless.
    values["scales"][20] = 0
    values["scales"][21] = -values["scales"][21]
    values["scales"][22] = 1e6
    values["scales"][23, 0] = 1e12
    values["scales"][24] = torch.tensor([1e9, 1e-9, 0])
    values["means"][25] = torch.tensor(cam.position + 0.011 * cam.forward).float()
    values["means"][26] = 1e30
    values["means"][27] = 3e38
    values["opacities"][28] = 7
    values["quats"][29] = 1e19
    values["scales"][30] = 1e-30
    values["colors"][31] = 1e6
    return Gaussians(**values)


@pytest.mark.parametrize("variant", VARIANTS)
def test_hostile_gaussians_leave_image_and_gradients_finite(variant: str) -> None:
    scene, cam = freaks(), camera(40, 30)
    found = run(CpuRenderer(variant=variant), scene, cam, torch.ones(30, 40, 3))
    assert not found.rendering.visible[1:16].any()
    assert found.rendering.visible[20:22].all()
    assert torch.isfinite(found.image).all()
    for name in FIELDS:
        assert torch.isfinite(found.grads[name]).all(), name
        assert not found.grads[name][1:16].any(), name
    assert torch.isfinite(found.screen).all()


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_negative_scale_is_the_same_as_a_positive_one(variant: str) -> None:
    cam = camera(40, 30)
    scene = random_scene(20, cam)
    mirrored = Gaussians(scene.means, scene.quats, -scene.scales, scene.opacities, scene.colors)
    weights = loss_weights(scene, cam)
    one = run(CpuRenderer(variant=variant), scene, cam, weights)
    other = run(CpuRenderer(variant=variant), mirrored, cam, weights)
    assert torch.equal(one.image, other.image)
    assert torch.equal(one.grads["scales"], -other.grads["scales"])


@pytest.mark.parametrize("size", [(1, 1), (33, 7)])
def test_no_gaussians_give_the_background_and_empty_gradients(size: tuple[int, int]) -> None:
    cam = camera(*size)
    scene = random_scene(0, cam)
    found = run(CpuRenderer(), scene, cam, torch.ones(size[1], size[0], 3))
    assert torch.equal(found.image, BACKGROUND.expand(size[1], size[0], 3))
    assert not found.rendering.alpha.any()
    assert found.screen.shape == (0, 2)
    assert found.grads["means"].shape == (0, 3)
    assert torch.equal(found.grads["background"], torch.full((3,), float(size[0] * size[1])))


def test_a_camera_that_sees_nothing_gives_the_background_and_zero_gradients() -> None:
    cam = camera(40, 30)
    scene = random_scene(50, cam)
    away = Camera(40, 30, cam.fx, cam.fy, cam.cx, cam.cy, np.diag([1.0, -1, -1, 1]) @ cam.w2c)
    found = run(CpuRenderer(), scene, away, torch.ones(30, 40, 3))
    assert torch.equal(found.image, BACKGROUND.expand(30, 40, 3))
    assert not any(found.grads[name].any() for name in FIELDS)
    assert not found.rendering.visible.any()


def test_a_pose_that_is_not_finite_gives_the_background() -> None:
    cam = camera(40, 30)
    scene = random_scene(50, cam)
    lost = Camera(40, 30, cam.fx, cam.fy, cam.cx, cam.cy, np.full((4, 4), np.nan))
    found = run(CpuRenderer(), scene, lost, torch.ones(30, 40, 3))
    assert torch.equal(found.image, BACKGROUND.expand(30, 40, 3))


def test_several_images_may_wait_for_their_backward() -> None:
    renderer = CpuRenderer()
    cam = camera(50, 40)
    scenes = [random_scene(100 + 50 * i, cam, seed=i) for i in range(3)]
    leaves = [scene.means.float().requires_grad_(True) for scene in scenes]
    images = [
        renderer.render(
            Gaussians(leaf, s.quats, s.scales, s.opacities, s.colors), cam, BACKGROUND
        ).image
        for leaf, s in zip(leaves, scenes, strict=True)
    ]
    sum(image.square().sum() for image in images).backward()
    for leaf, scene in zip(leaves, scenes, strict=True):
        alone = scene.means.float().requires_grad_(True)
        again = Gaussians(alone, scene.quats, scene.scales, scene.opacities, scene.colors)
        CpuRenderer().render(again, cam, BACKGROUND).image.square().sum().backward()
        assert torch.equal(leaf.grad, alone.grad)


def test_a_second_backward_of_the_same_image_gives_the_same_gradient() -> None:
    renderer = CpuRenderer()
    cam = camera(50, 40)
    scene = random_scene(100, cam)
    colors = scene.colors.float().requires_grad_(True)
    image = renderer.render(
        Gaussians(scene.means, scene.quats, scene.scales, scene.opacities, colors), cam, BACKGROUND
    ).image
    (first,) = torch.autograd.grad(image.sum(), colors, retain_graph=True)
    renderer.render(random_scene(400, cam, seed=2), cam, BACKGROUND)  # takes the frame over
    (second,) = torch.autograd.grad(image.sum(), colors)
    assert torch.equal(first, second)


@pytest.mark.parametrize("variant", VARIANTS)
def test_gradients_that_nobody_wants_are_not_made_and_the_others_are_the_same(variant: str) -> None:
    cam = camera(61, 40)
    scene = random_scene(300, cam, seed=9)
    weights = loss_weights(scene, cam).float()
    together = run(CpuRenderer(1, variant), scene, cam, weights)
    for name in FIELDS:
        leaf = getattr(scene, name).float().requires_grad_(True)
        rendering = CpuRenderer(1, variant).render(replace(scene, **{name: leaf}), cam, BACKGROUND)
        (rendering.image * weights).sum().backward()
        assert torch.equal(leaf.grad, together.grads[name])
        screen = together.screen if name == "means" else torch.zeros_like(together.screen)
        assert torch.equal(rendering.screen_grad(), screen)


def test_an_unknown_variant_is_refused() -> None:
    with pytest.raises(ValueError, match="mmx"):
        CpuRenderer(variant="mmx")


def test_wrong_shapes_are_refused_by_name() -> None:
    cam = camera(20, 20)
    scene = random_scene(5, cam)
    short = Gaussians(scene.means, scene.quats[:4], scene.scales, scene.opacities, scene.colors)
    with pytest.raises(ValueError, match="quats"):
        CpuRenderer().render(short, cam, BACKGROUND)


def crowd(count: int) -> Gaussians:
    """Gaussians that each fill any picture."""
    means = torch.zeros(count, 3) + torch.tensor([0.0, 0.0, 5.0])
    quats = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).expand(count, 4)
    half = torch.full((count, 3), 0.5)
    return Gaussians(means, quats, torch.full((count, 3), 20.0), half[:, 0], half)


@pytest.mark.parametrize("threads", [1, 4])
def test_a_picture_beyond_the_budget_is_refused_before_there_is_memory_for_it(threads: int) -> None:
    """20,000 Gaussians that touch 510 tiles each would take 367 MiB."""
    renderer, cam = CpuRenderer(threads, budgeted=True), camera(960, 540)
    with pytest.raises(SpaceError, match="over 5,318,784 pairs of Gaussian and tile"):
        renderer.render(crowd(20_000), cam, BACKGROUND)
    lease = renderer.take_frame()
    assert lease.frame is not None
    assert lease.frame.bytes < 64 << 20
    assert renderer.render(crowd(100), cam, BACKGROUND).image.isfinite().all()


def test_a_budget_changes_no_picture_within_it() -> None:
    cam = camera(200, 150)
    scene = random_scene(300, cam)
    free = CpuRenderer().render(scene, cam, BACKGROUND)
    bound = CpuRenderer(budgeted=True).render(scene, cam, BACKGROUND)
    assert torch.equal(free.image, bound.image)
