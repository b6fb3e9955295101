import torch

from gsynopsis.render.base import Gaussians
from gsynopsis.render.reference import ReferenceRenderer
from tests.render.raster_scenes import (
    BACKGROUND,
    FIELDS,
    camera,
    hand_scene,
    loss_weights,
    random_scene,
    run,
)


def test_gradients_are_those_of_central_differences() -> None:
    cam = camera(48, 36)
    scene = hand_scene(cam)
    weights = loss_weights(scene, cam)
    renderer = ReferenceRenderer()
    found = run(renderer, scene, cam, weights, torch.float64)

    def loss(changed: Gaussians) -> float:
        image = renderer.render(changed, cam, BACKGROUND.double()).image
        return float((image * weights).sum())

    step = 1e-6
    for name in FIELDS:
        values = getattr(scene, name)
        differences = torch.zeros_like(values)
        for i in range(values.numel()):
            ends = []
            for sign in (1, -1):
                moved = values.clone()
                moved.view(-1)[i] += sign * step
                ends.append(loss(Gaussians(**{**vars(scene), name: moved})))
            differences.view(-1)[i] = (ends[0] - ends[1]) / (2 * step)
        scale = differences.abs().max()
        assert (found.grads[name] - differences).abs().max() / scale < 1e-6, name


def test_the_screen_gradient_is_that_of_moving_the_principal_point() -> None:
    # Moving every projected centre at once is moving the principal point.
    cam = camera(48, 36)
    scene = hand_scene(cam)
    weights = loss_weights(scene, cam)
    renderer = ReferenceRenderer()
    found = run(renderer, scene, cam, weights, torch.float64)
    step = 1e-5
    for axis, name in enumerate(("cx", "cy")):
        ends = []
        for sign in (1, -1):
            moved = type(cam)(**{**vars(cam), name: getattr(cam, name) + sign * step})
            image = renderer.render(scene, moved, BACKGROUND.double()).image
            ends.append(float((image * weights).sum()))
        difference = (ends[0] - ends[1]) / (2 * step)
        assert abs(found.screen[:, axis].sum() - difference) < 1e-5 * abs(difference)


def test_no_gaussians_give_the_background() -> None:
    cam = camera(9, 7)
    found = run(ReferenceRenderer(), random_scene(0, cam), cam, torch.ones(7, 9, 3), torch.float64)
    assert torch.allclose(found.image, BACKGROUND.double().expand(7, 9, 3))
    assert found.grads["means"].shape == (0, 3)
    assert found.screen.shape == (0, 2)


def test_a_gaussian_that_is_not_finite_changes_nothing() -> None:
    cam = camera(30, 20)
    scene = random_scene(20, cam)
    spoilt = Gaussians(**{name: getattr(scene, name).clone() for name in FIELDS})
    spoilt.means[3] = float("nan")
    spoilt.quats[4] = 0
    without = Gaussians(
        **{name: torch.cat([getattr(scene, name)[:3], getattr(scene, name)[5:]]) for name in FIELDS}
    )
    weights = torch.ones(20, 30, 3)
    found = run(ReferenceRenderer(), spoilt, cam, weights, torch.float64)
    expected = run(ReferenceRenderer(), without, cam, weights, torch.float64)
    assert torch.equal(found.image, expected.image)
    for name in FIELDS:
        assert torch.isfinite(found.grads[name]).all()
        assert not found.grads[name][3:5].any()
