"""Photos sampled between their pixels: camera and photo agree, and only where there is detail."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from gsynopsis.evaluate.metrics import to_bytes
from gsynopsis.render.choose import make_renderer
from gsynopsis.scene.camera import STILL, Shift
from gsynopsis.scene.photos import PhotoCache
from gsynopsis.train.shifts import photo_bytes, subpixels_of
from gsynopsis.train.trainer import Trainer
from tests.tiny import half_size, tiny_config, tiny_model, tiny_scene

VIEW = 1


@pytest.fixture
def trainer(tmp_path: Path) -> Trainer:
    """A model before photos of itself, 96 × 64 pixels, which it is to see at half their size."""
    renderer, scene, model = make_renderer("cpu"), tiny_scene(size=(96, 64)), tiny_model()
    views = list(scene.views)
    with torch.no_grad():
        camera = scene.camera(VIEW)
        picture = renderer.render(model.decode(camera, 0), camera, torch.zeros(3))
    path = tmp_path / "photo.png"
    Image.fromarray(np.asarray(to_bytes(picture.image))).save(path)
    views[VIEW] = replace(views[VIEW], path=path)
    scene = replace(scene, views=tuple(views), cache=PhotoCache())
    trainer = Trainer(scene, half_size(tiny_config()), renderer)
    trainer.adopt(model)
    return trainer


def error(trainer: Trainer, drawn: Shift, sampled: Shift) -> float:
    """Mean squared difference of a picture and a photo, each at its own shift."""
    assert trainer.model is not None
    camera = trainer.scene.camera(VIEW, 2, drawn)
    with torch.no_grad():
        gaussians = trainer.model.decode(camera, 0)
        picture = trainer.renderer.render(gaussians, camera, trainer.background).image
    return float((picture - trainer.target(VIEW, 2, sampled)).square().mean())


@pytest.mark.parametrize("shift", [(0.25, 0.25), (-0.25, 0.25), (0.5, 0.0), (0.0, -0.5)])
def test_picture_and_photo_agree_at_the_same_shift_and_at_no_other(
    trainer: Trainer, shift: Shift
) -> None:
    right = error(trainer, shift, shift)
    for other in (STILL, (-shift[0], -shift[1]), (-shift[1] - 0.2, shift[0])):
        assert right < 0.8 * error(trainer, shift, other)
    trainer.shift = shift
    assert trainer.model is not None
    seen = trainer.forward(trainer.model.part(0), VIEW, 2)
    assert seen.error == pytest.approx(right, rel=1e-6)


def test_photos_that_are_hardly_reduced_or_too_many_to_keep_are_not_shifted(
    trainer: Trainer,
) -> None:
    scene, half = trainer.scene, trainer.config
    photos = 3 * 48 * 32 * len(scene.train)
    assert photo_bytes(scene, half) == photos and subpixels_of(scene, half) == 2
    assert subpixels_of(scene, replace(half, scale=1.5)) == 1
    for budget, expected in ((4 * photos, 2), (4 * photos - 1, 1)):
        small = replace(scene, cache=PhotoCache(budget))
        assert subpixels_of(small, half) == expected
        other = Trainer(small, half, trainer.renderer)
        other.next_views()
        assert (other.shift == STILL) == (expected == 1)


def test_each_step_draws_one_of_the_places_and_a_single_place_draws_nothing(
    trainer: Trainer,
) -> None:
    found = set()
    for _ in range(60):
        trainer.next_views()
        found.add(trainer.shift)
    assert found == {(a, b) for a in (-0.25, 0.25) for b in (-0.25, 0.25)}
    plain = Trainer(trainer.scene, tiny_config(), trainer.renderer)
    order = [plain.next_view() for _ in range(20)]
    again = Trainer(trainer.scene, tiny_config(), trainer.renderer)
    assert [again.next_views() for _ in range(20)] == [[view] for view in order]
    assert again.shift == STILL
