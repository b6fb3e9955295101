"""Decoding: levels, records and the odd cases."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

from gsynopsis.model.anchors import AnchorModel, LearntMask
from gsynopsis.model.build import freeze_codes, model_from_levels, model_to_levels
from gsynopsis.model.levels import (
    child_part,
    nested_masks,
    rank_masks,
    spread_scores,
    without_faint,
)
from gsynopsis.pack import decode, encode
from gsynopsis.render.choose import make_renderer
from tests.tiny import TINY_MODEL, look_at, tiny_model, tiny_scene

CAMERA = tiny_scene().camera(1, 1)


def levelled(model: AnchorModel) -> AnchorModel:
    """Four nested levels with a slot mask that is not whole anchors."""
    generator = torch.Generator().manual_seed(9)
    scores = torch.rand(len(model), generator=generator)
    finest = torch.rand(len(model), model.slots, generator=generator) > 0.2
    masks = [m & finest for m in rank_masks([scores] * 4, [0.2, 0.4, 0.7, 1.0], model.slots)]
    model.part(0).mask = masks[-1]
    for mask in reversed(masks[:-1]):
        parent = model.part(0)
        part = child_part(model, parent, mask, max(0, parent.grids - 1))
        part.networks["opacity_b2"].data += 0.05
        part.log_gain.data += 0.1
        model.parts.insert(0, part)
    return model


@pytest.mark.parametrize(
    "config",
    [
        TINY_MODEL,
        replace(TINY_MODEL, fusion="mlp", residual=2),
        replace(TINY_MODEL, feature="free"),
        replace(TINY_MODEL, codebook=0, residual=3),
        replace(TINY_MODEL, slots=1),
        replace(TINY_MODEL, grids=0),
    ],
)
@pytest.mark.parametrize("coding", ["raw", "compact"])
def test_deltas_render_bit_for_bit_what_a_direct_load_renders(config, coding: str) -> None:
    levels = model_to_levels(levelled(tiny_model(config)), {})
    stored = decode(encode(levels, coding), "memory")
    renderer = make_renderer("cpu")
    for number in range(4):
        from_all = model_from_levels(stored).decode(CAMERA, number)
        from_part = model_from_levels(stored.upto(number)).decode(CAMERA, number)
        assert len(from_all) > 0
        images = [renderer.render(g, CAMERA, torch.zeros(3)).image for g in (from_all, from_part)]
        assert torch.equal(images[0], images[1])


def test_a_frozen_code_renders_what_the_soft_index_rendered() -> None:
    model = tiny_model()
    before = model.decode(CAMERA)
    freeze_codes(model)
    after = model.decode(CAMERA)
    assert torch.equal(before.colors, after.colors) and model.logits.shape[1] == 0


def test_a_record_and_back_renders_the_same_gaussians() -> None:
    model = levelled(tiny_model())
    again = model_from_levels(model_to_levels(model, {}))
    for level in range(4):
        a, b = model.decode(CAMERA, level), again.decode(CAMERA, level)
        order_a, order_b = (np.lexsort(g.means.detach().numpy().T) for g in (a, b))
        assert torch.allclose(a.means[order_a], b.means[order_b], atol=1e-6)
        assert torch.allclose(a.scales[order_a], b.scales[order_b], rtol=1e-5)


def test_zeroed_features_equal_deleted_columns() -> None:
    model = tiny_model()
    parent = model.part(-1)
    child = child_part(model, parent, parent.mask, 2)
    dropped = model.layout.offsets[2]
    short = model.decode_part(child, CAMERA).gaussians
    with torch.no_grad():
        model.table[dropped:] = 0
    zeroed = model.decode_part(parent, CAMERA).gaussians
    assert torch.allclose(short.colors, zeroed.colors, atol=1e-6)
    assert torch.allclose(short.opacities, zeroed.opacities, atol=1e-6)


def test_child_masks_are_subsets_of_their_parents() -> None:
    levels = model_to_levels(levelled(tiny_model()), {}).levels
    for coarse, fine in pairwise(levels):
        assert not (coarse.mask & ~fine.mask[: coarse.anchors]).any()


def test_a_child_lies_on_the_device_of_its_parent() -> None:
    model = tiny_model().to("meta")
    child = child_part(model, model.part(-1), model.part(-1).mask, 2)
    assert {p.device.type for p in child.parameters()} == {"meta"}


def test_nested_masks_add_what_a_coarser_level_shows() -> None:
    coarse, fine = torch.tensor([[True, False]]), torch.tensor([[False, True]])
    assert nested_masks([coarse, fine])[1].tolist() == [[True, True]]


def test_rank_masks_keep_the_best_and_at_least_one() -> None:
    masks = rank_masks([torch.tensor([0.1, 0.9, 0.5])] * 3, [0.01, 0.67, 1.0], 2)
    assert masks[0].tolist() == [[False] * 2, [True] * 2, [False] * 2]
    assert masks[1][:, 0].tolist() == [False, True, True] and bool(masks[2].all())


def test_rank_masks_keep_what_coarser_levels_have_whatever_its_score_is() -> None:
    coarse, fine = torch.tensor([9.0, 1.0, 2.0, 3.0]), torch.tensor([0.0, 5.0, 7.0, 6.0])
    masks = rank_masks([coarse, fine, fine], [0.25, 0.5, 0.75], 1)
    rows = [mask[:, 0].tolist() for mask in masks]
    assert rows == [
        [True, False, False, False],
        [True, False, True, False],
        [True, False, True, True],
    ]


def test_without_faint_drops_what_has_at_most_a_share_of_the_effect() -> None:
    effects = torch.tensor([[0.0, 1.0, 40.0], [3.0, 50.0, 6.0]])
    assert without_faint(effects, 0.0, 0.0).all()
    assert without_faint(effects, 0.011, 0.0).tolist() == [[False, False, True], [True, True, True]]
    assert without_faint(effects, 0.0399, 0).equal(without_faint(effects, 0.011, 0))
    assert without_faint(effects, 0.101, 0.0).tolist() == [
        [False, False, True],
        [False, True, False],
    ]
    assert without_faint(effects, 0.99, 0.0).sum() == 1, "the strongest stays"
    assert without_faint(torch.zeros(2, 3), 0.1, 0.0).all(), "no effect at all: nothing is fainter"
    assert without_faint(effects.log(), 0.1, 0.0).all(), "not finite: whoever trains on says so"


def test_without_faint_lets_the_fewest_bytes_of_an_anchor_and_its_slots_have_the_most_effect() -> (
    None
):
    """The oracle: of all choices, none that loses as little takes less room."""
    generator = torch.Generator().manual_seed(3)
    for cost in (0.0, 0.7, 2.0):
        effects = torch.rand(4, 3, generator=generator) ** 3
        kept = without_faint(effects, 0.2, cost)
        assert 0 < kept.sum() < 12
        every = torch.cartesian_prod(*[torch.tensor([False, True])] * 12).view(-1, 4, 3)
        left = (effects * every).sum(dim=(1, 2))
        room = every.sum(dim=(1, 2)) + cost * every.any(dim=2).sum(dim=1)
        own = int(kept.sum()) + cost * int(kept.any(dim=1).sum())
        best = left[room <= own + 1e-6].max()
        assert (effects * kept).sum() == pytest.approx(float(best))
        assert (effects * ~kept).sum() <= 0.2 * effects.sum()


def test_learnt_masks_pass_the_sigmoid_gradient_to_drawn_slots_only() -> None:
    model = tiny_model()
    logits = torch.full((len(model), model.slots), 1.0)
    logits[::2] = -9.0
    logits.requires_grad_(True)
    decoded = model.decode_part(model.part(-1), CAMERA, LearntMask(logits, 0.01))
    drawn = torch.zeros(logits.numel(), dtype=torch.bool)
    drawn[decoded.slots] = True
    assert not drawn.view_as(logits)[::2].any()
    g = decoded.gaussians
    (g.opacities.sum() + g.scales.sum()).backward()
    soft = torch.tensor(1.0).sigmoid()
    expected = (g.opacities + g.scales.sum(dim=1)) * soft * (1 - soft)
    assert logits.grad is not None
    assert torch.allclose(logits.grad.reshape(-1)[decoded.slots], expected, rtol=1e-4)
    assert not logits.grad.reshape(-1)[~drawn].any()


def test_a_camera_that_sees_no_anchor_gets_the_background_and_finite_gradients() -> None:
    model = tiny_model()
    away = look_at(np.array([0.0, 0.0, -20.0]), np.array([0.0, 0.0, -40.0]), 8, 6)
    decoded = model.decode_part(model.part(-1), away)
    image = make_renderer("cpu").render(decoded.gaussians, away, torch.tensor([0.2, 0.4, 0.6]))
    assert len(decoded.gaussians) == 0
    assert torch.allclose(image.image, torch.tensor([0.2, 0.4, 0.6]).expand(6, 8, 3))
    image.image.sum().backward()
    assert all(p.grad is None or bool(torch.isfinite(p.grad).all()) for p in model.parameters())


def test_a_camera_inside_an_anchor_gives_finite_pictures_and_gradients() -> None:
    model = tiny_model()
    x, _ = model.placed()
    eye = x[0].numpy().astype(np.float64)
    inside = look_at(eye, eye + np.array([0.3, 0.1, 1.0]), 8, 6)
    decoded = model.decode_part(model.part(-1), inside)
    image = make_renderer("cpu").render(decoded.gaussians, inside, torch.zeros(3)).image
    image.sum().backward()
    assert bool(torch.isfinite(image).all())
    assert all(p.grad is None or bool(torch.isfinite(p.grad).all()) for p in model.parameters())


@pytest.mark.parametrize("anchors", [0, 1])
def test_levels_with_no_anchor_or_one_are_drawn(anchors: int) -> None:
    model = levelled(tiny_model())
    mask = torch.zeros_like(model.part(0).mask)
    rows = model.part(0).mask.any(dim=1).nonzero()[:anchors, 0]
    mask[rows] = model.part(0).mask[rows]
    model.part(0).mask = mask
    stored = decode(encode(model_to_levels(model, {}), "raw"), "memory")
    again = model_from_levels(stored)
    gaussians = again.decode(CAMERA, 0)
    image = make_renderer("cpu").render(gaussians, CAMERA, torch.zeros(3)).image
    assert stored.levels[0].anchors == anchors and bool(torch.isfinite(image).all())


def test_spread_scores_keep_an_anchor_in_every_region() -> None:
    near = torch.cartesian_prod(*[torch.arange(6)] * 3)
    far = torch.tensor([[400, 0, 0], [0, 400, 0], [0, 0, 400]])
    lattice = torch.cat([near, far])
    scores = torch.cat([torch.linspace(1.0, 2.0, len(near)), torch.full((3,), 0.5)])
    best = torch.topk(spread_scores(lattice, scores, 0.05), 12).indices
    assert {216, 217, 218} <= set(best.tolist())
    assert int(best[0]) == 215  # the best of a cell keeps its score
    assert not (torch.topk(scores, 12).indices >= 216).any()


def test_spread_scores_of_one_anchor_and_of_equal_ones() -> None:
    one = spread_scores(torch.zeros(1, 3, dtype=torch.int64), torch.tensor([3.0]), 0.5)
    assert one.tolist() == [3.0]
    same = spread_scores(torch.zeros(3, 3, dtype=torch.int64), torch.ones(3), 0.5)
    assert same.tolist() == pytest.approx([1.0, 1 / 2, 1 / 3])
