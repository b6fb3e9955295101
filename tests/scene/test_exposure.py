"""Exposure that differs is seen at the sparse points."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsynopsis.scene.exposure import DIFFERENT, brightness_spread, log_gains
from gsynopsis.scene.scene import load_scene


@pytest.fixture
def changed(small_room: Path, tmp_path: Path) -> tuple[Path, np.ndarray]:
    """The procedural room with made-up gains, and these, [V, 3]."""
    rng = np.random.default_rng(5)
    out = tmp_path / "changed"
    shutil.copytree(small_room, out)
    gains = []
    for path in sorted((out / "images").iterdir()):
        gains.append(rng.uniform(0.75, 1.05) * rng.uniform(0.9, 1.05, 3))
        with Image.open(path) as photo:
            pixels = np.rint((np.asarray(photo) * gains[-1]).clip(0, 255)).astype(np.uint8)
        Image.fromarray(pixels).save(path)
    return out, np.array(gains)


def test_made_up_gains_are_found_and_the_original_has_none(small_room, changed) -> None:
    folder, gains = changed
    scene = load_scene(folder, "none")
    wanted = np.log(gains)
    found = log_gains(scene, scene.train) - log_gains(load_scene(small_room, "none"), scene.train)
    assert found == pytest.approx(wanted - wanted.mean(axis=0), abs=0.05)
    assert brightness_spread(scene) > DIFFERENT > brightness_spread(load_scene(small_room, "none"))


def test_a_real_scene_of_one_exposure_is_left_alone(real_scene) -> None:
    assert brightness_spread(load_scene(real_scene("fox"))) < DIFFERENT
