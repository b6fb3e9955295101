"""What blocks add, against pictures that are drawn with and without."""

import numpy as np
import torch

from gsynopsis.evaluate.gains import cameras_of, measure_gains
from gsynopsis.model.build import model_from_levels
from gsynopsis.pack import Assembler
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import Camera
from tests.stream.scenes import small_file
from tests.tiny import look_at, tiny_scene


def whole() -> Assembler:
    assembler = Assembler(small_file(), "small")
    for _ in assembler.index.levels:
        assembler.add_level(small_file())
    return assembler


def around(count: int) -> list[Camera]:
    angles = np.arange(count) * (2 * np.pi / count)
    eyes = [np.array([40 * np.sin(a), -3.0, 40 * np.cos(a)]) for a in angles]
    return [look_at(eye, np.zeros(3), 48, 36) for eye in eyes]


def level_errors(assembler: Assembler, cameras: list[Camera]) -> list[float]:
    """Mean squared error of each level against the finest: the plain account."""
    model = model_from_levels(assembler.level_set())
    renderer, black = CpuRenderer(), torch.zeros(3)
    found = np.zeros(len(model.parts))
    with torch.no_grad():
        for camera in cameras:
            images = [
                renderer.render(model.decode(camera, level), camera, black).image.clamp(0, 1)
                for level in range(len(model.parts))
            ]
            found += [float((image - images[-1]).square().mean()) for image in images]
    return (found / len(cameras)).tolist()


def test_gains_of_one_block_a_level_are_the_differences_of_whole_levels() -> None:
    # With one block, its share of every picture is all of it.
    data = small_file(10_000)
    assembler = Assembler(data, "small")
    for _ in assembler.index.levels:
        assembler.add_level(data)
    assert {level.blocks for level in assembler.index.levels} == {1}
    cameras = around(3)
    errors = level_errors(assembler, cameras)
    gains = [float(level[0]) for level in measure_gains(assembler, cameras, CpuRenderer())]
    for level, gain in enumerate(gains, start=1):
        step = errors[level - 1] - errors[level]
        # Errors where nothing of the finest level covers the picture belong to no block.
        assert gain <= step * 1.001 + 1e-9 or step < 0
        assert gain >= 0.5 * step


def test_every_block_has_a_gain_from_0_to_1_and_they_differ() -> None:
    assembler = whole()
    seen: list[tuple[int, int]] = []
    gains = measure_gains(assembler, around(4), CpuRenderer(), lambda *done: seen.append(done))
    assert [len(level) for level in gains] == [e.blocks for e in assembler.index.levels[1:]]
    assert all(((level >= 0) & (level <= 1)).all() for level in gains)
    assert gains[-1].max() > 1.5 * gains[-1].min()
    assert seen == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_gains_are_measured_in_training_views_of_modest_size() -> None:
    scene = tiny_scene()
    cameras = cameras_of(scene, 1.0)
    assert 1 <= len(cameras) <= 16
    assert cameras[0].width == min(240, scene.camera(0, 1.0).width)
