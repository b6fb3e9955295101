"""What a splat is worth counts what is left beside it."""

import numpy as np
import pytest
import torch

from gsynopsis.model.splats import SplatModel
from gsynopsis.records import PlainGaussians
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import Camera
from gsynopsis.teacher.ranking import UNSEEN, worth_of, worth_of_few

COUNT = 800


@pytest.fixture
def camera() -> Camera:
    w2c = np.eye(4)
    w2c[2, 3] = 10.0
    return Camera(width=96, height=64, fx=80.0, fy=80.0, cx=48.0, cy=32.0, w2c=w2c)


@pytest.fixture
def splats(rng: np.random.Generator) -> PlainGaussians:
    """A slab of many that overlap, of several colours."""
    means = rng.uniform((-4, -2.4, -0.5), (4, 2.4, 0.5), (COUNT, 3))
    return PlainGaussians(
        means.astype(np.float32),
        np.full((COUNT, 3), np.log(0.25), np.float32),
        np.tile(np.array([1, 0, 0, 0], np.float32), (COUNT, 1)),
        rng.normal(1.0, 1.0, COUNT).astype(np.float32),
        rng.normal(0.5, 1.0, (COUNT, 1, 3)).astype(np.float32),
    )


def quiet(what: str, done: int, total: int) -> None:
    assert what == "ranking splats" and 1 <= done <= total


def lost(splats: PlainGaussians, worth: np.ndarray, count: int, camera: Camera) -> float:
    """Mean squared change of the image when all but those of the highest worth are gone."""
    model, renderer, black = SplatModel(splats), CpuRenderer(1), torch.zeros(3)
    kept = model.part(-1).of_rows(torch.from_numpy(np.argsort(-worth)[:count]))
    images = [
        renderer.render(model.decode_part(part, camera).gaussians, camera, black).image
        for part in (model.part(-1), kept)
    ]
    return float((images[0] - images[1]).square().mean())


@pytest.mark.parametrize("count", [COUNT // 8, COUNT // 4])
def test_a_few_that_are_ranked_again_show_more_than_once_ranked(
    count: int, splats: PlainGaussians, camera: Camera
) -> None:
    model, renderer, prior = SplatModel(splats), CpuRenderer(1), np.ones(len(splats))
    worth = worth_of(model, prior, [camera], renderer, quiet)
    few = worth_of_few(model, worth, count, [camera], renderer, quiet)
    assert (few >= worth).all()
    assert lost(splats, few, count, camera) < 0.85 * lost(splats, worth, count, camera)


@pytest.mark.parametrize("least", [1, COUNT // 4, COUNT - 1, COUNT])
def test_what_went_at_one_step_is_behind_all_that_stayed(
    least: int, splats: PlainGaussians, camera: Camera
) -> None:
    model, renderer = SplatModel(splats), CpuRenderer(1)
    worth = worth_of(model, np.ones(len(splats)), [camera, camera], renderer, quiet)
    before = worth.copy()
    few = worth_of_few(model, worth, least, [camera, camera], renderer, quiet)
    assert np.array_equal(worth, before), "the argument is as it was"
    kept = round(len(splats) * 2**-0.5)
    if least >= kept:
        assert np.array_equal(few, worth)
        return
    gone = np.argsort(-worth, kind="stable")[kept:]
    stayed = np.setdiff1d(np.arange(len(splats)), gone)
    assert few[gone].max() <= few[stayed].min()
    again = worth_of_few(model, worth, least, [camera, camera], renderer, quiet)
    assert np.array_equal(few, again)


def test_what_no_camera_sees_is_worth_a_little(splats: PlainGaussians, camera: Camera) -> None:
    away = splats.means.copy()
    away[-1, 2] = -100.0
    model = SplatModel(PlainGaussians(away, *list(vars(splats).values())[1:]))
    prior = np.ones(len(splats))
    worth = worth_of(model, prior, [camera], CpuRenderer(1), quiet)
    assert 0 < worth[-1] <= 2 * UNSEEN * np.quantile(worth[:-1], 0.05)
    assert torch.isfinite(torch.from_numpy(worth)).all()
