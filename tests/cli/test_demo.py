"""The demo, without its training."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gsynopsis.cli import demo, main
from gsynopsis.cli.flags import asked_of
from gsynopsis.cli.train import Train
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.stored import read_header
from gsynopsis.synthetic import make_scene as synthetic
from gsynopsis.synthetic.raytracer import RayScene


def black(world: RayScene, camera: Camera) -> NDArray[np.uint8]:
    return np.zeros((camera.height, camera.width, 3), np.uint8)


def test_the_demo_s_photos_are_large_enough_for_a_browser_window(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trained: list[Train] = []
    monkeypatch.setattr(Train, "run", lambda self: trained.append(self) or 0)
    # The photos of two views, black: the ray caster takes its time.
    whole = synthetic.make_scene
    monkeypatch.setattr(synthetic, "make_scene", lambda *a, **k: whole(*a, **k, views=2, points=9))
    monkeypatch.setattr(synthetic, "render", black)
    assert main(["demo", "--out", str(tmp_path), "--quiet"]) == 0
    (train,) = trained
    photos = sorted((train.scene / "images").iterdir())
    sizes = [read_header(photo).size for photo in photos]
    assert len(sizes) == 2
    assert all(width >= 480 and height >= 320 for width, height in sizes)
    assert train.scale == 1.0
    assert asked_of(train.overrides)["train.steps"] == demo.Demo.steps
