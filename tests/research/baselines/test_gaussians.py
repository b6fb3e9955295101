"""3DGS: it starts from points, comes nearer to photos, grows where it is told to, holds still."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gsynopsis.model.plain import PlainModel
from gsynopsis.records import SH_0, PlainGaussians
from gsynopsis.render.choose import make_renderer
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene
from gsynopsis.synthetic.make_scene import make_scene
from research.baselines import gaussians
from research.baselines.gaussians import (
    Training,
    from_points,
    photo,
    prefix,
    rotation,
    train_gaussians,
)

RENDERER = make_renderer("cpu")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    folder = tmp_path_factory.mktemp("baseline") / "room"
    return load_scene(make_scene("room", folder, views=10, width=48, height=32, points=200))


def error_of(found: PlainGaussians, scene: Scene, count: int | None = None) -> float:
    model, total = PlainModel(found, antialiased=False), 0.0
    with torch.no_grad():
        for view in scene.train:
            camera = scene.camera(view)
            drawn = prefix(model.decode(camera), len(found) if count is None else count)
            image = RENDERER.render(drawn, camera, torch.zeros(3)).image
            total += float((image - photo(scene, view, 1, image.device)).square().mean())
    return total / len(scene.train)


def same(a: PlainGaussians, b: PlainGaussians) -> bool:
    return all(
        np.array_equal(x, y) for x, y in zip(vars(a).values(), vars(b).values(), strict=True)
    )


def test_it_starts_as_round_gaussians_of_the_points_colours(scene: Scene) -> None:
    start = from_points(scene)
    points = np.concatenate([scene.points, scene.backdrop])
    assert len(start) == len(points) > len(scene.points) and start.degree == 3
    colors = start.sh[:, 0] * SH_0 + 0.5
    assert np.allclose(colors[: len(scene.points)], scene.colors / 255, atol=1e-6)
    assert np.allclose(colors[len(scene.points) :], 0.5, atol=1e-6)
    assert not start.sh[:, 1:].any()
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    near = np.sort(distances, axis=1)[:, 1:4]
    wanted = 0.5 * np.log(np.square(near).mean(axis=1))
    assert np.allclose(start.log_scales, wanted[:, None], atol=1e-4)


def test_pictures_come_nearer_to_the_photos_and_a_seed_gives_the_same_bits(scene: Scene) -> None:
    start = from_points(scene)
    training = Training(60, 1, grow=True, rates=4)
    one, two, other = (
        train_gaussians(start, scene, RENDERER, replace(training, seed=seed)) for seed in (0, 0, 1)
    )
    assert same(one, two) and not same(one, other)
    assert error_of(one, scene) < 0.5 * error_of(start, scene)


def test_it_grows_up_to_its_bound_and_prunes_what_is_faint(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gaussians, "EVERY", 10)
    start = from_points(scene)
    faint = start.logits.copy()
    faint[:5] = -20
    start = replace(start, logits=faint)
    training = Training(60, 1, grow=True, reset=False)
    free = train_gaussians(start, scene, RENDERER, training)
    assert len(free) > 1.2 * len(start)
    assert (1 / (1 + np.exp(-free.logits)) > 1e-4).all(), "the faint ones are gone"
    bound = train_gaussians(start, scene, RENDERER, replace(training, most=len(start) + 7))
    assert len(bound) <= len(start) + 7 * 2


def test_a_reset_leaves_nothing_opaque(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """The one of step 10 of 20, after which nothing has time to come back."""
    monkeypatch.setattr(gaussians, "EVERY", 10)
    monkeypatch.setattr(gaussians, "RESET", 0.4)
    monkeypatch.setattr(gaussians, "RESET_UNTIL", 0.5)
    monkeypatch.setattr(gaussians, "AVERAGED", 0.05)
    monkeypatch.setattr(gaussians, "THRESHOLD", 1e9)
    start = from_points(scene)
    kept, reset = (
        train_gaussians(start, scene, RENDERER, Training(22, 1, grow=True, reset=r, rates=0.01))
        for r in (False, True)
    )
    assert kept.logits.max() > -2.5 > reset.logits.max() > -5


def test_frozen_rows_stay_bit_for_bit_while_others_grow(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gaussians, "EVERY", 10)
    start = from_points(scene)
    found = train_gaussians(start, scene, RENDERER, Training(40, 1, grow=True, frozen=50))
    for before, after in zip(vars(start).values(), vars(found).values(), strict=True):
        assert np.array_equal(before[:50], after[:50])
    assert len(found) > len(start) and not np.array_equal(start.means[50:60], found.means[50:60])


def test_only_drawn_rows_learn(scene: Scene) -> None:
    start = from_points(scene)
    drawn = Training(20, 1, drawn=lambda chance, count: (count // 2,))
    found = train_gaussians(start, scene, RENDERER, drawn)
    half = len(start) // 2
    assert np.array_equal(found.means[half:], start.means[half:])
    assert error_of(found, scene, half) < error_of(start, scene, half)


def test_rotations_are_those_of_quaternions() -> None:
    turned = rotation(torch.tensor([[2.0, 0, 0, 0], [1, 0, 0, 1]]))
    assert torch.equal(turned[0], torch.eye(3))
    quarter = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    assert torch.allclose(turned[1], quarter, atol=1e-6)


def test_a_photo_that_is_gone_is_one_line(scene: Scene, tmp_path: Path) -> None:
    from gsynopsis.errors import SceneError

    folder = make_scene("room", tmp_path / "room", views=10, width=48, height=32, points=200)
    there = load_scene(folder)
    there.views[there.train[0]].path.write_bytes(b"no photo")
    with pytest.raises(SceneError, match=there.views[there.train[0]].path.name):
        train_gaussians(from_points(there), there, RENDERER, Training(20, 1))


def test_a_step_adds_up_the_losses_of_its_images(scene: Scene) -> None:
    """Both images of all rows: gradients are twice as large, and Adam moves as for one."""
    start = from_points(scene)
    one, two = (
        train_gaussians(start, scene, RENDERER, Training(3, 1, drawn=lambda _, n, k=k: (n,) * k))
        for k in (1, 2)
    )
    # Round Gaussians have no direction: their turns, and so their axes, follow rounding noise.
    for name in ("means", "logits", "sh"):
        assert np.allclose(getattr(one, name), getattr(two, name), atol=1e-5)
    assert np.allclose(one.log_scales, two.log_scales, atol=1e-3)
    part = Training(3, 1, drawn=lambda _, n: (n // 2, n))
    both = train_gaussians(start, scene, RENDERER, part)
    half = len(start) // 2
    assert not same(one, both) and not np.array_equal(both.means[half:], start.means[half:])


def test_opacities_of_frozen_rows_learn_where_they_may(scene: Scene) -> None:
    start = from_points(scene)
    training = Training(10, 1, frozen=50, opacities=True)
    found = train_gaussians(start, scene, RENDERER, training)
    for name, before in vars(start).items():
        same_rows = np.array_equal(before[:50], vars(found)[name][:50])
        assert same_rows == (name != "logits"), name


def test_the_result_is_the_mean_of_the_last_values(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    start, values = from_points(scene), list[np.ndarray]()
    monkeypatch.setattr(gaussians, "AVERAGED", 0.5)
    trainer = gaussians.Trainer(start, scene, RENDERER, Training(8, 1))
    found = trainer.run(lambda *_: values.append(trainer.model.means.detach().numpy().copy()))
    assert np.allclose(found.means, np.mean(values[4:], axis=0), atol=1e-6)


def test_photos_are_sampled_between_their_pixels(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    shifts = set[tuple[float, float]]()
    drawn = gaussians.photo

    def watched(scene, view, scale, device, shift):
        shifts.add(shift)
        return drawn(scene, view, scale, device, shift)

    monkeypatch.setattr(gaussians, "photo", watched)
    train_gaussians(from_points(scene), scene, RENDERER, Training(30, 2, subpixels=2))
    assert shifts == {(x, y) for x in (-0.25, 0.25) for y in (-0.25, 0.25)}
