"""Block utilities, against images that are rendered with and without the blocks."""

import numpy as np
import torch

from gsynopsis.container import Assembler
from gsynopsis.evaluation.block_utility import cameras_of, measure_utilities
from gsynopsis.model.build import model_from_levels
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


def test_utilities_of_one_block_a_level_are_the_differences_of_whole_levels() -> None:
    # With one block, its share of every image is all of it.
    data = small_file(10_000)
    assembler = Assembler(data, "small")
    for _ in assembler.index.levels:
        assembler.add_level(data)
    assert {level.blocks for level in assembler.index.levels} == {1}
    cameras = around(3)
    errors = level_errors(assembler, cameras)
    utilities = [float(level[0]) for level in measure_utilities(assembler, cameras, CpuRenderer())]
    for level, utility in enumerate(utilities, start=1):
        step = errors[level - 1] - errors[level]
        # Errors where nothing of the finest level covers the image belong to no block.
        assert utility <= step * 1.001 + 1e-9 or step < 0
        assert utility >= 0.5 * step


def test_every_block_has_a_utility_from_0_to_1_and_they_differ() -> None:
    assembler = whole()
    seen: list[tuple[int, int]] = []
    utilities = measure_utilities(
        assembler, around(4), CpuRenderer(), lambda *done: seen.append(done)
    )
    assert [len(level) for level in utilities] == [e.blocks for e in assembler.index.levels[1:]]
    assert all(((level >= 0) & (level <= 1)).all() for level in utilities)
    assert utilities[-1].max() > 1.5 * utilities[-1].min()
    assert seen == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_utilities_are_measured_in_training_views_of_modest_size() -> None:
    scene = tiny_scene()
    cameras = cameras_of(scene, 1.0)
    assert 1 <= len(cameras) <= 16
    assert cameras[0].width == min(240, scene.camera(0, 1.0).width)
