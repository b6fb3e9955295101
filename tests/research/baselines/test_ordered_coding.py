"""Rounding of splats: steps lose what was ordered, by the formula and in images."""

import numpy as np
import pytest
import torch

from gsynopsis.evaluation.metrics import psnr
from gsynopsis.evaluation.protocols import LevelRenderer
from gsynopsis.model.splat_levels import row_order, small_scale, splat_levels
from gsynopsis.model.splats import SplatModel, decoder_of
from gsynopsis.records import PlainGaussians
from gsynopsis.render.choose import make_renderer
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene
from gsynopsis.synthetic.make_scene import make_scene
from research.baselines.gaussians import Training, from_points, photo, train_gaussians
from research.baselines.level_opacities import LevelOpacities, opacity_columns
from research.baselines.ordered_coding import (
    COARSEST,
    CODINGS,
    KINDS,
    View,
    coded_harmonics,
    entropy_of,
    ordered_steps,
    rounded_down,
    sensitivity_of,
    steps_for,
)

RENDERER = make_renderer("cpu")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    folder = tmp_path_factory.mktemp("coded") / "room"
    return load_scene(make_scene("room", folder, views=8, width=48, height=32, points=200))


@pytest.fixture(scope="module")
def trained(scene: Scene) -> PlainGaussians:
    training = Training(150, 1, rates=4)
    return train_gaussians(from_points(scene, 1), scene, RENDERER, training)


def views(scene: Scene) -> list[View]:
    device = torch.device("cpu")
    return [View(scene.camera(v), photo(scene, v, 1, device)) for v in scene.train]


def test_steps_share_the_order_by_the_number_of_values() -> None:
    sums = {name: 10.0 + place for place, name in enumerate(KINDS)}
    steps = steps_for(sums, 0.1)
    lost = {name: sums[name] * steps[name] ** 2 / 12 for name in KINDS}
    assert sum(lost.values()) == pytest.approx(0.1)
    assert lost["position"] == pytest.approx(3 * lost["luma"])


def test_steps_are_few_powers_of_two() -> None:
    assert [rounded_down(x) for x in (1.0, 0.26, 0.3, 0.49, 3.9)] == [1, 0.25, 0.25, 0.4375, 3.5]
    for step in np.geomspace(1e-4, 10, 97):
        assert 0.79 * step < rounded_down(step) <= step


def test_images_lose_about_what_was_ordered(scene: Scene, trained: PlainGaussians) -> None:
    worth, count = np.arange(len(trained), 0, -1.0), len(trained)
    sensitivity = sensitivity_of([trained], lambda _: views(scene), RENDERER)
    lost = dict[float, float]()
    for order in (0.1, 0.4):
        steps = ordered_steps(trained, worth, [count], sensitivity, order)
        read = decoder_of(splat_levels(trained, worth, [count], {}, steps))
        shown = [
            [
                psnr(LevelRenderer(model, RENDERER).paint(camera, 0), image)
                for camera, image in ((scene.camera(v), scene.image(v)) for v in scene.train)
            ]
            for model in (SplatModel(trained), read)
        ]
        lost[order] = float(np.mean(shown[0]) - np.mean(shown[1]))
    assert 0 < lost[0.1] < 0.2 and lost[0.1] < lost[0.4] < 0.8


def test_harmonics_lose_what_their_coding_says(scene: Scene, trained: PlainGaussians) -> None:
    count = len(trained)
    counts, worth = [count // 4, count], np.arange(count, 0, -1.0)
    sensitivity = sensitivity_of([trained], lambda _: views(scene), RENDERER)
    each = sensitivity.harmonics_each
    ways = coded_harmonics(trained, worth, counts, sensitivity, 1e-6)
    assert len(ways) == len(CODINGS)
    for way in ways[:2]:
        levels = splat_levels(trained, worth, counts, {}, way.steps, weights=each)
        read = decoder_of(levels)
        assert isinstance(read, SplatModel)
        order = row_order(trained, worth, counts, way.steps)
        error = np.square(read.sh[:, 1:].double().numpy() - trained.sh[order, 1:])
        lost = float((sensitivity.harmonics.numpy()[order] * error).sum())
        assert lost == pytest.approx(way.lost, rel=1e-4)
    assert min(way.lost for way in ways) < ways[0].lost


def test_the_entropy_is_that_of_a_fair_coin_and_of_nothing() -> None:
    assert entropy_of(np.array([0, 1] * 8, np.uint8)) == 16
    assert entropy_of(np.full(5, 3, np.uint8)) == 0


def test_steps_are_no_longer_than_rounding_is_linear(scene: Scene, trained: PlainGaussians) -> None:
    worth, count = np.arange(len(trained), 0, -1.0), len(trained)
    sensitivity = sensitivity_of([trained], lambda _: views(scene), RENDERER)
    steps = ordered_steps(trained, worth, [count], sensitivity, 1e9)
    for name, most in COARSEST.items():
        assert getattr(steps, name) == rounded_down(most)
    assert steps.stages == 1 and small_scale(trained) > 0


def test_sensitivity_is_the_most_of_any_level(scene: Scene, trained: PlainGaussians) -> None:
    half = PlainGaussians(*(v[: len(trained) // 2] for v in vars(trained).values()))
    both = sensitivity_of([half, trained], lambda _: views(scene), RENDERER)
    alone = [sensitivity_of([one], lambda _: views(scene), RENDERER) for one in (half, trained)]
    for name in KINDS:
        first, whole = (found.kinds[name] for found in alone)
        expected = whole.clone()
        expected[: len(half)] = expected[: len(half)].maximum(first)
        assert torch.equal(both.kinds[name], expected)


def test_levels_have_opacities_of_their_own(scene: Scene, trained: PlainGaussians) -> None:
    chance = np.random.default_rng(0)
    counts = [len(trained) // 4, len(trained) // 2, len(trained)]
    logits = [chance.normal(0, 2, n).astype(np.float32) for n in counts]
    order = np.concatenate(
        [
            chance.permutation(np.arange(a, b))
            for a, b in zip([0, *counts[:-1]], counts, strict=True)
        ]
    )
    columns, extra = opacity_columns(logits, order, 1 / 8)
    assert extra[0] == 0 and all(
        0 < more <= n + 16 for more, n in zip(extra[1:], counts, strict=False)
    )
    for own, column in zip(logits, columns, strict=True):
        slow = np.array([np.clip(own[order[row]], -6, 6) for row in range(len(own))])
        assert np.abs(column - slow).max() <= 1 / 16 + 1e-6
    model = SplatModel(trained)
    shown = LevelOpacities.of(model, [logits[-1]])
    camera = scene.camera(scene.test[0])
    decoded = shown.decode_level(0, camera)
    expected = torch.tensor(logits[-1]).sigmoid()[decoded.anchors]
    assert torch.equal(decoded.gaussians.opacities, expected)
    assert torch.equal(decoded.gaussians.means, model.decode(camera, 0).means)
