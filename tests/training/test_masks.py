"""Masks in the loss."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from gsynopsis.render.choose import make_renderer
from gsynopsis.scene.scene import SceneOptions
from gsynopsis.training.context import TrainContext
from gsynopsis.training.device_photos import DevicePhotos
from gsynopsis.training.state import TrainState, fresh_state
from gsynopsis.training.view_step import compare, forward_view
from tests.devices import DEVICES
from tests.tiny import tiny_config, tiny_scene


def masked_state(tmp_path: Path, white: int) -> TrainState:
    """A training on 24 × 16 pixels of which the left columns are inside."""
    pixels = np.zeros((16, 24), np.uint8)
    pixels[:, :white] = 255
    Image.fromarray(pixels).save(tmp_path / "mask.png")
    scene = tiny_scene()
    views = tuple(replace(view, mask=tmp_path / "mask.png") for view in scene.views)
    scene = replace(scene, views=views)
    return fresh_state(TrainContext(scene, tiny_config(), make_renderer("cpu")))


def test_pixels_outside_have_no_gradient_and_the_loss_is_a_mean_over_those_inside(
    tmp_path: Path,
) -> None:
    state = masked_state(tmp_path, 12)
    target, image = torch.rand(16, 24, 3), torch.rand(16, 24, 3, requires_grad=True)
    compared, share = compare(state, image, target, 1, 1)
    assert share == 0.5
    (compared - target).abs().mean().div(share).backward()
    assert image.grad is not None and not image.grad[:, 12:].any()
    wanted = (image - target)[:, :12].abs().mean()
    found = (compared - target).abs().mean().detach() / share
    assert float(found) == pytest.approx(float(wanted.detach()))
    assert torch.equal(compared[:, 12:], target[:, 12:])


def test_a_mask_that_is_white_all_over_changes_nothing(tmp_path: Path) -> None:
    state = masked_state(tmp_path, 24)
    plain = fresh_state(TrainContext(tiny_scene(), tiny_config(), make_renderer("cpu")))
    one = forward_view(state, state.model.part(-1), 1, 1)[0]
    two = forward_view(plain, plain.model.part(-1), 1, 1)[0]
    assert float(one.loss.detach()) == pytest.approx(float(two.loss.detach()), rel=1e-5)
    assert float(one.error) == pytest.approx(float(two.error), rel=1e-5)


@pytest.mark.parametrize("device", DEVICES)
def test_masks_come_to_a_device_with_their_photos(device: str, tmp_path: Path) -> None:
    state = masked_state(tmp_path, 12)
    own = state.context.scene
    scene = replace(own, views=(replace(own.views[0], mask=None), *own.views[1:]))
    photos = DevicePhotos(scene, torch.device(device))
    assert photos.mask(0, 1) is None and photos.held == 3 * 24 * 16
    found, expected = photos.mask(1, 2, (0.25, 0.25)), scene.mask(1, 2, (0.25, 0.25))
    assert found is not None and expected is not None and found[0].device.type == device
    assert np.array_equal(found[0].cpu().numpy(), expected) and found[1] == expected.mean()
    assert photos.held == 3 * 24 * 16 + 7 * 12 * 8
    photos.close()
    empty = DevicePhotos(replace(scene, reading=SceneOptions(masks="off")), torch.device(device))
    assert empty.mask(1, 1) is None
    empty.close()


def test_a_step_on_photos_brought_ahead_has_the_same_loss(tmp_path: Path) -> None:
    plain, ahead = masked_state(tmp_path, 12), masked_state(tmp_path, 12)
    ahead.photos = DevicePhotos(ahead.context.scene, torch.device("cpu"))
    losses = [forward_view(s, s.model.part(-1), 1, 1)[0].loss.detach() for s in (plain, ahead)]
    ahead.photos.close()
    assert torch.equal(*losses) and float(losses[0]) > 0
