"""What goes into a file: slots within a box."""

import pytest
import torch

from gsynopsis.errors import SettingError
from gsynopsis.jobs.write_file import crop_to
from gsynopsis.model.anchors import AnchorModel
from tests.tiny import tiny_model


def centers(model: AnchorModel) -> torch.Tensor:
    """Of all slots, [N, K, 3]."""
    x, _ = model.placed()
    return (x[:, None] + model.offsets * model.log_scales[:, None, :3].exp()).detach()


def test_a_crop_leaves_the_live_slots_within_its_box() -> None:
    model = tiny_model()
    before = [part.mask.clone() for part in model.level_parts()]
    places = centers(model)
    low, high = places.flatten(0, 1).quantile(0.25, dim=0), places.flatten(0, 1).amax(dim=0)
    crop_to(model, (*low.tolist(), *high.tolist()))  # type: ignore[arg-type]
    inside = ((places >= low) & (places <= high)).all(dim=2)
    for part, mask in zip(model.level_parts(), before, strict=True):
        assert torch.equal(part.mask, mask & inside)
    assert 0 < int(model.part(-1).mask.sum()) < int(before[-1].sum())


def test_a_crop_of_nothing_is_refused_with_where_the_scene_is() -> None:
    with pytest.raises(SettingError, match="a box with nothing in it") as caught:
        crop_to(tiny_model(), (1e6, 1e6, 1e6, 2e6, 2e6, 2e6))
    assert "where the scene is" in str(caught.value)
