"""Our presets train a scene in metres and in kilometres alike."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsynopsis.config import RATES, Config, resolve_settings
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene
from gsynopsis.synthetic.make_scene import make_scene
from gsynopsis.training.context import TrainContext
from gsynopsis.training.loop import open_state, phases_of
from gsynopsis.training.observer import Silent
from gsynopsis.training.state import set_optimizer

LARGE = 64.0
STEPS = 20


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    out = tmp_path_factory.mktemp("units") / "room"
    return load_scene(make_scene("room", out, views=10, width=48, height=32, points=800))


def in_other_units(scene: Scene, factor: float) -> Scene:
    """The same photos of a world that is `factor` times as large."""

    def larger(w2c: np.ndarray) -> np.ndarray:
        moved = w2c.copy()
        moved[:3, 3] *= factor
        return moved

    views = tuple(
        replace(view, camera=replace(view.camera, w2c=larger(view.camera.w2c)))
        for view in scene.views
    )
    return replace(scene, views=views, points=scene.points * factor)


def losses(scene: Scene, config: Config) -> list[float]:
    """Of the first steps, before anything grows."""
    state = open_state(TrainContext(scene, config, CpuRenderer()), Path("nowhere"), Silent())
    phase = phases_of(config)[0]
    phase.begin(state)
    set_optimizer(state, phase.make_optimizer(state))
    found: list[float] = []
    for _ in range(STEPS):
        phase.step(state)
        state.progress.step += 1
        found.append(state.progress.loss)
    return found


def test_a_scene_in_other_units_trains_alike(room: Scene) -> None:
    config = resolve_settings("standard", None, {}).config
    large = in_other_units(room, LARGE)
    assert large.extent == pytest.approx(LARGE * room.extent)
    small, found = losses(room, config), losses(large, config)
    assert small[-1] < 0.99 * small[0]
    assert found == pytest.approx(small, rel=1e-3)
    # In the unit of the scene, as Scaffold-GS has it, offsets are thrown about.
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(RATES, "ours", replace(RATES["ours"], unit_extent=0.0))
        thrown = losses(large, config)
    assert thrown[-1] > 1.02 * small[-1]
