"""What no point explains gets a far shell, and what is covered does not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsynopsis.config import resolve_settings
from gsynopsis.scene.backdrop import FAR, backdrop_points
from gsynopsis.scene.camera import Camera, look_at
from gsynopsis.scene.load import load_scene
from gsynopsis.synthetic.make_scene import UP, make_scene
from gsynopsis.training.state import set_optimizer


def ring(views: int, radius: float = 3.0) -> list[Camera]:
    cameras: list[Camera] = []
    for angle in np.arange(views) * (2 * np.pi / views):
        eye = np.array([radius * np.cos(angle), radius * np.sin(angle), 0.5])
        w2c = look_at(eye, np.array([0.0, 0.0, 0.4]), UP)
        cameras.append(Camera(96, 64, 80.0, 80.0, 48.0, 32.0, w2c))
    return cameras


def directions(count: int) -> np.ndarray:
    points = np.random.default_rng(0).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def test_an_object_alone_has_a_backdrop_all_around() -> None:
    found = backdrop_points(ring(24), 0.3 * directions(2000), 3.3)
    middle = np.array([0.0, 0.0, 0.5])
    np.testing.assert_allclose(np.linalg.norm(found - middle, axis=1), FAR * 3.3, rtol=1e-9)
    azimuth = np.arctan2(found[:, 1], found[:, 0])
    assert set(np.floor(azimuth / (np.pi / 8)).astype(int)) == set(range(-8, 8))
    assert 100 < len(found) < 1800
    # Nothing above and below, where no camera looks.
    assert np.abs(found[:, 2] / np.linalg.norm(found, axis=1)).max() < 0.8
    again = backdrop_points(ring(24), 0.3 * directions(2000), 3.3)
    assert np.array_equal(found, again)


def test_what_points_cover_needs_none() -> None:
    everywhere = np.concatenate([20 * directions(60_000), directions(50)])
    assert len(backdrop_points(ring(24), everywhere, 3.3)) == 0


def test_a_gap_in_what_is_covered_is_filled_alone() -> None:
    points = 20 * directions(60_000)
    gap = (points[:, 0] > 16) & (np.abs(points[:, 2]) < 6)
    found = backdrop_points(ring(24), points[~gap], 3.3)
    assert 20 < len(found) < 120
    assert (found[:, 0] > 0.6 * np.linalg.norm(found, axis=1)).all()


def test_a_scene_without_points_is_backdrop_where_cameras_look() -> None:
    assert len(backdrop_points(ring(12), np.zeros((0, 3)), 3.3)) > 100


STEPS = 150


@pytest.mark.slow
def test_an_object_before_a_plain_backdrop_is_not_lost_behind_a_veil(tmp_path: Path) -> None:
    from gsynopsis.render.cpu import CpuRenderer
    from gsynopsis.training.loop import open_state, phases_of
    from gsynopsis.training.observer import Silent
    from gsynopsis.training.state import TrainContext

    scene = load_scene(make_scene("object", tmp_path / "object", views=24, width=96, height=96))
    asked = {"train.steps": STEPS, "levels.steps": STEPS}
    config = resolve_settings("standard", len(scene.train), asked).config
    found = dict[bool, float]()
    for backdrop in (True, False):
        bare = replace(scene)
        bare.__dict__["backdrop"] = np.zeros((0, 3))
        context = TrainContext(scene if backdrop else bare, config, CpuRenderer())
        state = open_state(context, tmp_path / "none", Silent())
        phase = phases_of(config)[0]
        phase.begin(state)
        set_optimizer(state, phase.make_optimizer(state))
        for _ in range(STEPS):
            phase.step(state)
            state.progress.step += 1
        found[backdrop] = state.progress.psnr
    assert found[True] > found[False] + 4
