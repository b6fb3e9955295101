"""Decoding: levels, records and the odd cases."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

from gsynopsis.container import decode, encode
from gsynopsis.model.anchors import AnchorModel, LearntMask
from gsynopsis.model.build import freeze_codes, model_from_levels, model_to_levels
from gsynopsis.model.levels import coarser_part
from gsynopsis.render.choose import make_renderer
from tests.tiny import TINY_MODEL, look_at, tiny_model, tiny_scene

CAMERA = tiny_scene().camera(1, 1)


def levelled(model: AnchorModel) -> AnchorModel:
    """Four nested levels with a slot mask that is not whole anchors."""
    generator = torch.Generator().manual_seed(9)
    place = torch.rand(len(model), generator=generator).argsort().argsort() / len(model)
    finest = torch.rand(len(model), model.slots, generator=generator) > 0.2
    masks = [(place < share)[:, None] & finest for share in (0.2, 0.4, 0.7, 1.0)]
    model.part(0).mask = masks[-1]
    for mask in reversed(masks[:-1]):
        parent = model.part(0)
        part = coarser_part(model, parent, mask, max(0, parent.grids - 1))
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
    child = coarser_part(model, parent, parent.mask, 2)
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
    child = coarser_part(model, model.part(-1), model.part(-1).mask, 2)
    assert {p.device.type for p in child.parameters()} == {"meta"}


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
