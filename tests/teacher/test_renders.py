"""A folder of renders read back as a scene."""

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from gsynopsis.scene.camera import STILL, Camera, look_at
from gsynopsis.scene.load import load_scene
from gsynopsis.teacher.renders import ALPHA, IMAGES, RenderedAlpha, name_of, write_scene

UP = np.array([0.0, 0.0, 1.0])
PLACES = [np.array([3 * np.cos(a), 3 * np.sin(a), 1.0]) for a in np.linspace(0, 5, 6)]
CAMERAS = [Camera(12, 8, 10.0, 11.0, 6.5, 4.0, look_at(eye, np.zeros(3), UP)) for eye in PLACES]
POINTS = np.random.default_rng(0).normal(size=(40, 3))
COLORS = np.random.default_rng(1).integers(0, 256, (40, 3)).astype(np.uint8)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    views = {"train": CAMERAS[:4], "test": CAMERAS[4:5], "val": CAMERAS[5:]}
    for part, cameras in views.items():
        for number, camera in enumerate(cameras):
            shape = (camera.height, camera.width)
            path = tmp_path / IMAGES / name_of(part, number)
            path.parent.mkdir(exist_ok=True)
            Image.fromarray(np.full((*shape, 3), 10 * number, np.uint8)).save(path)
            if part == "train":
                path = tmp_path / ALPHA / name_of(part, number)
                path.parent.mkdir(exist_ok=True)
                alpha = np.zeros(shape, np.uint8)
                alpha[:, : camera.width // 2] = 255
                Image.fromarray(alpha).save(path)
    write_scene(views, POINTS, COLORS, tmp_path, "renders of a splat", (0.0, 0.6, 0.8))
    return tmp_path


def test_cameras_points_and_parts_come_back(folder: Path) -> None:
    scene = load_scene(folder)
    names = [view.name for view in scene.views]
    assert [Path(names[view]).name for view in scene.train] == [
        name_of("train", number) for number in range(4)
    ]
    assert [Path(names[view]).name for view in scene.test] == [name_of("test", 0)]
    for camera, view in zip(CAMERAS[:4], scene.train, strict=True):
        found = scene.camera(view)
        assert np.allclose(found.w2c, camera.w2c, atol=1e-9)
        assert (found.fx, found.fy, found.cx, found.cy) == (10.0, 11.0, 6.5, 4.0)
    assert scene.up == (0.0, 0.6, 0.8)
    assert np.allclose(scene.points, POINTS) and np.array_equal(scene.colors, COLORS)


def test_alpha_is_that_of_the_view_at_any_size(folder: Path) -> None:
    scene = load_scene(folder)
    alpha = RenderedAlpha(scene)
    whole = alpha(scene.train[0], 1, STILL)
    assert whole.shape == (8, 12) and whole.dtype == torch.float32
    assert bool((whole[:, :6] == 1).all()) and bool((whole[:, 6:] == 0).all())
    half = alpha(scene.train[0], 2, STILL)
    assert half.shape == (4, 6) and float(half.mean()) == pytest.approx(0.5, abs=0.02)
    assert torch.equal(alpha(scene.train[0], 1, STILL), whole)
