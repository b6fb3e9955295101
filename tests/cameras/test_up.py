"""Up is found where surfaces tell it, whatever the axes; where they do not, the custom stays."""

from dataclasses import replace

import numpy as np
import pytest

from gsynopsis.cameras.found import Search
from gsynopsis.cameras.placement import subject_of
from gsynopsis.cameras.up import guesses
from gsynopsis.cameras.viewpoints import for_splats
from gsynopsis.formats.axes import quaternion_of, turned
from gsynopsis.formats.readers.base import SplatFile
from gsynopsis.scene.camera import look_at
from tests.cameras.splat_scenes import SCENES, UP, after_a_step, park

CUSTOM = (0.0, -1.0, 0.0)


@pytest.fixture(autouse=True)
def no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Up is known before cameras are sought, which are not looked at here."""
    monkeypatch.setattr(Search, "tries", Search.quick_tries)


def off(one: object, other: object) -> float:
    """Degrees between directions."""
    return float(np.degrees(np.arccos(np.clip(np.dot(np.array(one), np.array(other)), -1, 1))))


@pytest.mark.parametrize("name", ["room without ceiling", "terrain", "street", "tree"])
def test_up_is_found_within_five_degrees(name: str) -> None:
    """As in ODM's and RealityCapture's files, whose up is z and whose format's custom is -y."""
    found = for_splats(SplatFile((SCENES[name]().gaussians,), up=CUSTOM), count=4)
    assert off(found.up, UP) < 5
    assert any("up is" in line for line in found.lines)


def test_a_park_is_not_upside_down_though_its_ground_is_seen_best_from_below() -> None:
    found = for_splats(SplatFile((park(),), up=CUSTOM), count=4)
    assert off(found.up, UP) < 5


@pytest.mark.parametrize("name", ["room without ceiling", "street"])
def test_up_is_found_in_a_world_that_is_tilted(name: str) -> None:
    """As in COLMAP's own worlds, which follow the first photo."""
    scene = SCENES[name]()
    up = np.array([0.25, -0.9, 0.3]) / np.linalg.norm([0.25, -0.9, 0.3])
    rotation = look_at(np.zeros(3), np.array([0.3, 0.1, 1.0]), up)[:3, :3]
    # The camera's y points down: its turn takes z to `up` after a quarter turn about x.
    matrix = rotation.T @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    gaussians = turned(scene.gaussians, quaternion_of(matrix))
    found = for_splats(SplatFile((gaussians,), up=CUSTOM), count=4)
    assert off(found.up, matrix @ np.array(UP)) < 5


def test_an_object_without_ground_keeps_the_custom_of_its_format() -> None:
    found = for_splats(SplatFile((SCENES["hollow sphere"]().gaussians,), up=CUSTOM), count=4)
    assert found.up == CUSTOM


@pytest.mark.parametrize("name", ["hollow sphere", "opaque specks", "thick shell"])
def test_what_lies_across_no_axis_more_than_by_chance_is_no_reason_to_turn(name: str) -> None:
    """A few more splats of a bust than by chance stood along z: it was turned to its other side."""
    gaussians = SCENES[name]().gaussians
    (only,) = guesses(gaussians, subject_of(gaussians, CUSTOM), CUSTOM)
    assert tuple(only.up) == CUSTOM


@pytest.mark.parametrize("up", [(0.0, 1.0, 0.0), (0.0, 0.0, -1.0)])
def test_a_file_is_not_upside_down_whose_photos_looked_down(up: tuple[float, ...]) -> None:
    """As COLMAP's worlds in SPZ files, which by custom are y up; and photos taken from the air."""
    scene = SCENES["hollow sphere"]() if up[1] else SCENES["terrain"]()
    gaussians = scene.gaussians if up[1] else turned(scene.gaussians, np.array([0.0, 1, 0, 0]))
    custom = -np.array(up)
    assert off(for_splats(SplatFile((gaussians,), up=tuple(custom)), count=4).up, up) > 90
    chance = np.random.default_rng(0)
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    around = np.stack([np.cos(turn), 0.3 * np.ones(40), np.sin(turn)], axis=1)
    to = around if up[1] else np.array(up) + 0.5 * chance.standard_normal((40, 3))
    sh = np.concatenate([gaussians.sh[:, :1], after_a_step(len(gaussians), to, chance)], axis=1)
    found = for_splats(SplatFile((replace(gaussians, sh=sh),), up=tuple(custom)), count=4)
    assert off(found.up, up) < 5


def test_what_the_file_or_the_caller_says_is_up() -> None:
    file = SplatFile((SCENES["street"]().gaussians,), up=CUSTOM)
    assert for_splats(replace(file, up_said=True), count=4).up == CUSTOM
    assert for_splats(file, (1.0, 0.0, 0.0), count=4).up == (1.0, 0.0, 0.0)
