"""The heads are asked for no other views than those of training."""

from collections.abc import Generator

import numpy as np
import pytest
import torch

from gsynopsis.model.anchors import AnchorModel
from gsynopsis.model.build import freeze_codes, model_from_levels, model_to_levels
from gsynopsis.model.multi_level import MultiLevelModel
from gsynopsis.model.view_bounds import (
    ViewBounds,
    parse_view_bounds,
    view_bounds_of,
    view_bounds_text,
)
from gsynopsis.records import SEEN_NOTE
from gsynopsis.render.base import Gaussians
from gsynopsis.scene.camera import Camera
from tests.tiny import look_at, tiny_model, tiny_scene

SEEN = ViewBounds((0.1, -0.2, 1 / 3), 2.0, 0.25, float(np.float32(1.7)))


@pytest.fixture(autouse=True)
def _no_gradients() -> Generator[None]:
    with torch.no_grad():
        yield


def trained() -> tuple[AnchorModel, list[Camera], ViewBounds]:
    """A model whose heads feel the distance, the cameras of its training, and what they saw."""
    scene, model = tiny_scene(), tiny_model()
    freeze_codes(model)
    for name in ("opacity_w1", "cov_w1", "color_w1"):
        model.part(-1).networks[name].data[:, -1] *= 20
    cameras = [scene.camera(view, 1) for view in scene.train]
    eyes = np.stack([camera.position for camera in cameras])
    return model, cameras, view_bounds_of(eyes, model.placed()[0], model.frame.extent)


def away_from(camera: Camera, model: AnchorModel, factor: float) -> Camera:
    """The same look at the middle of the anchors from farther away."""
    middle = model.placed()[0].mean(dim=0).numpy().astype(np.float64)
    eye = middle + factor * (camera.position - middle)
    return look_at(eye, middle, camera.width, camera.height)


def equal(one: Gaussians, other: Gaussians) -> bool:
    names = ("means", "quats", "scales", "opacities", "colors")
    return all(torch.equal(getattr(one, name), getattr(other, name)) for name in names)


def test_the_note_changes_no_bit_of_the_views_of_training() -> None:
    model, cameras, seen = trained()
    plain = [model.decode(camera) for camera in cameras]
    model.seen = parse_view_bounds(view_bounds_text(seen))
    assert model.seen == seen
    for camera, before in zip(cameras, plain, strict=True):
        assert equal(model.decode(camera), before)


def test_from_far_away_all_looks_as_from_the_nearest_place_of_training() -> None:
    model, cameras, seen = trained()
    far = away_from(cameras[0], model, 40.0)
    wild = model.decode(far).colors.mean(dim=0)
    model.seen = seen
    calm = model.decode(far)
    rows = calm.colors.mean(dim=0)
    near = model.decode(cameras[0]).colors.mean(dim=0)
    assert float((rows - near).abs().max()) < 0.1 < float((wild - near).abs().max())
    farther = model.decode(away_from(cameras[0], model, 4000.0))
    assert torch.allclose(farther.colors, calm.colors, atol=2e-3)


def test_every_decoder_of_a_file_keeps_to_its_note() -> None:
    model, cameras, seen = trained()
    far = away_from(cameras[0], model, 40.0)
    plain = model.decode(far)
    levels = model_to_levels(model, {SEEN_NOTE: view_bounds_text(seen)})
    model.seen = seen
    read, region = model_from_levels(levels), np.zeros(levels.levels[-1].anchors, np.uint8)
    mixed = MultiLevelModel(levels, region, torch.device("cpu"))
    for decoder in (read, mixed):
        colors = decoder.decode(far).colors
        assert float((colors.mean(dim=0) - model.decode(far).colors.mean(dim=0)).abs().max()) < 1e-5
        assert float((colors.mean(dim=0) - plain.colors.mean(dim=0)).abs().max()) > 0.1


def test_a_note_comes_back_to_the_last_bit() -> None:
    seen = parse_view_bounds(view_bounds_text(SEEN))
    assert seen is not None and (seen.low, seen.high) == (SEEN.low, SEEN.high)
    assert view_bounds_text(seen) == view_bounds_text(SEEN)


def test_eyes_among_the_cameras_stay_and_others_come_to_the_nearest_place() -> None:
    inside = (0.1, 1.0, 1.0)
    assert SEEN.nearest(inside) == inside
    found = np.subtract(SEEN.nearest((50.0, 60.0, -70.0)), SEEN.center)
    out = np.subtract((50.0, 60.0, -70.0), SEEN.center)
    assert np.allclose(found, 2.0 * out / np.linalg.norm(out))


@pytest.mark.parametrize(
    "text",
    [
        *(None, "", "[]", "7", "null", "[" * 100_000),
        '{"center":[0,0,0],"radius":1}',
        '{"center":[0,0],"radius":1,"distance":[0,1]}',
        '{"center":[0,0,true],"radius":1,"distance":[0,1]}',
        '{"center":[0,0,0],"radius":0,"distance":[0,1]}',
        '{"center":[0,0,0],"radius":[1],"distance":[0,1]}',
        '{"center":[0,0,0],"radius":1,"distance":[2,1]}',
        '{"center":[0,0,0],"radius":1,"distance":[-1,1]}',
        '{"center":[0,0,0],"radius":1,"distance":[0,1e39]}',
        '{"center":[0,0,0],"radius":1e999,"distance":[0,1]}',
        '{"center":[0,0,NaN],"radius":1,"distance":[0,1]}',
    ],
)
def test_what_is_no_note_is_ignored(text: str | None) -> None:
    assert parse_view_bounds(text) is None
