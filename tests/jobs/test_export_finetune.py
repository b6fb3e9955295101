"""Fine-tuning gives back what is missing, and nothing else changes."""

import numpy as np
import torch

from gsynopsis.jobs.export_finetune import FineTuning, Shot, fine_tune
from gsynopsis.model.bake import Baking, bake
from gsynopsis.model.plain import PlainModel
from gsynopsis.render.choose import make_renderer
from tests.tiny import tiny_model, tiny_scene

SCENE = tiny_scene()
RENDERER = make_renderer("cpu")


def shot(number: int) -> Shot:
    view = SCENE.train[number]
    return Shot(SCENE.camera(view), torch.tensor(SCENE.image(view)).float() / 255)


def error_of(model: PlainModel) -> float:
    with torch.no_grad():
        pairs = [shot(number) for number in range(len(SCENE.train))]
        black = torch.zeros(3)
        images = [RENDERER.render(model.decode(p.camera), p.camera, black).image for p in pairs]
        return float(
            np.mean([(i - p.picture).square().mean() for i, p in zip(images, pairs, strict=True)])
        )


def baked(degree: int = 1):
    cameras = [SCENE.camera(view) for view in SCENE.train]
    return bake(tiny_model(), -1, cameras, RENDERER, Baking(degree))


def tuned(gaussians, steps: int, seed: int = 0):
    model = PlainModel(gaussians, antialiased=False)
    before = error_of(model)
    tuning = FineTuning(steps, SCENE.extent, seed)
    found = fine_tune(model, len(SCENE.train), shot, RENDERER, tuning)
    return found, before, error_of(model)


def test_pictures_come_nearer_to_the_photos() -> None:
    for degree in (0, 1):
        found, before, after = tuned(baked(degree), 60)
        assert after < 0.7 * before
        assert found.degree == degree


def test_the_same_seed_gives_the_same_gaussians() -> None:
    gaussians = baked()
    one, two, other = (tuned(gaussians, 10, seed)[0] for seed in (0, 0, 1))
    assert np.array_equal(one.sh, two.sh)
    assert not np.array_equal(one.sh, other.sh)


def test_no_step_leaves_everything_as_it_was() -> None:
    gaussians = baked()
    found, before, after = tuned(gaussians, 0)
    assert before == after
    assert np.array_equal(found.means, gaussians.means)


def test_torch_has_one_thread_meanwhile() -> None:
    """Its threads spin: beside a busy process a step took sixteen times as long."""
    seen = set[int]()
    before = torch.get_num_threads()

    def watched(number: int):
        seen.add(torch.get_num_threads())
        return shot(number)

    model = PlainModel(baked(), antialiased=False)
    tuning = FineTuning(2, SCENE.extent, 0)
    torch.set_num_threads(2)
    try:
        fine_tune(model, len(SCENE.train), watched, RENDERER, tuning)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
    assert seen == {1}
