import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch

from gsynopsis.model.build import model_from_levels, model_to_levels
from gsynopsis.model.levels import coarser_part
from gsynopsis.model.multi_level import KeyedGaussians, MultiLevelModel, cross_fade
from gsynopsis.records import LevelSet
from gsynopsis.render.base import Gaussians
from gsynopsis.render.reference import ReferenceRenderer
from tests.tiny import tiny_model, tiny_scene

CPU = torch.device("cpu")


def two_levels() -> LevelSet:
    model = tiny_model()
    fine = model.part(-1)
    keep = torch.zeros_like(fine.mask)
    keep[::2] = True
    coarse = coarser_part(model, fine, keep, 2)
    with torch.no_grad():
        coarse.codebook.add_(0.3)
    model.parts.insert(0, coarse)
    return model_to_levels(model, {})


def picture(model: MultiLevelModel) -> np.ndarray:
    camera = tiny_scene().views[4].camera
    gaussians = model.decode(camera)
    return ReferenceRenderer().render(gaussians, camera, torch.zeros(3)).image.numpy()


@pytest.mark.parametrize("level", [0, 1])
def test_all_regions_at_one_level_are_that_level(level: int) -> None:
    levels = two_levels().upto(level)
    camera = tiny_scene().views[4].camera
    region = np.full(levels.levels[-1].anchors, level, np.uint8)
    mixed = MultiLevelModel(levels, region, CPU)
    plain = model_from_levels(levels)
    with torch.no_grad():
        image = (
            ReferenceRenderer().render(plain.decode(camera, level), camera, torch.zeros(3)).image
        )
    assert np.allclose(picture(mixed), image.numpy(), atol=1e-6)


def states() -> tuple[MultiLevelModel, MultiLevelModel]:
    levels = two_levels()
    low = levels.upto(0)
    return (
        MultiLevelModel(low, np.zeros(low.levels[-1].anchors, np.uint8), CPU),
        MultiLevelModel(levels, np.ones(levels.levels[-1].anchors, np.uint8), CPU),
    )


def test_names_are_unique_and_the_same_in_both_states() -> None:
    camera = tiny_scene().views[4].camera
    before, after = (state.named(camera) for state in states())
    for named in (before, after):
        pairs = list(zip(named.cells.tolist(), named.slots.tolist(), strict=True))
        assert pairs == sorted(set(pairs))
    shared = {*zip(before.cells.tolist(), before.slots.tolist(), strict=True)}
    assert len(shared & {*zip(after.cells.tolist(), after.slots.tolist(), strict=True)}) > 5


def test_cells_far_from_the_origin_have_names_of_their_own() -> None:
    """With 17 bits an axis, cells 2^17 apart along x and one along y had the same name."""
    levels = two_levels()
    lattice = levels.shared.lattice.copy()
    lattice[:, 0] += (np.arange(len(lattice), dtype=np.int32) % 8 - 4) << 17
    lattice[:, 1] += np.arange(len(lattice), dtype=np.int32) % 8
    far = replace(levels, shared=replace(levels.shared, lattice=lattice))
    region = np.ones(len(lattice), np.uint8)
    mixed = MultiLevelModel(far, region, CPU)
    assert len(torch.unique(mixed._cells)) == len(np.unique(lattice, axis=0)) == len(lattice)


def test_a_fade_begins_at_the_old_and_ends_at_the_new_picture_in_small_steps() -> None:
    camera = tiny_scene().views[4].camera
    before, after = (state.named(camera) for state in states())
    pictures = [
        ReferenceRenderer()
        .render(cross_fade(before, after, step / 8), camera, torch.zeros(3))
        .image.numpy()
        for step in range(9)
    ]
    hard = np.abs(pictures[-1] - pictures[0])
    assert hard.max() > 0.02
    soft = [np.abs(b - a) for a, b in itertools.pairwise(pictures)]
    assert max(float(step.mean()) for step in soft) < 0.25 * float(hard.mean())
    almost = cross_fade(before, after, 1 - 1e-6)
    image = ReferenceRenderer().render(almost, camera, torch.zeros(3)).image.numpy()
    assert np.allclose(image, pictures[-1], atol=1e-3)


def test_a_fade_from_nothing_is_a_fade_in() -> None:
    camera = tiny_scene().views[4].camera
    before, after = (state.named(camera) for state in states())
    g = before.gaussians
    nothing = Gaussians(g.means[:0], g.quats[:0], g.scales[:0], g.opacities[:0], g.colors[:0])
    none = KeyedGaussians(before.cells[:0], before.slots[:0], nothing)
    half = cross_fade(none, after, 0.5)
    assert len(half) == len(after.gaussians)
    assert torch.allclose(half.opacities, 0.5 * after.gaussians.opacities)
