"""Splats that were made of one photo are seen from where it was taken, not from behind."""

from dataclasses import replace

import numpy as np
import pytest

from gsynopsis.cameras.one_photo import REACH, of_one_photo
from gsynopsis.formats.readers.base import PhotoCamera, SplatFile
from gsynopsis.records import PlainGaussians
from tests.cameras.splat_scenes import SCENES

SIDE, FOCAL = 96, 80.0
NEAR, FAR = 2.0, 5.0


def pixels_of(width: int = SIDE, height: int = 64) -> PlainGaussians:
    """A splat for each pixel of a photo: a wall, and a ball before it."""
    y, x = (np.mgrid[:height, :width] + 0.5).reshape(2, -1)
    x, y = (x - width / 2) / FOCAL, (y - height / 2) / FOCAL
    depth = np.where(x * x + y * y < 0.04, NEAR, FAR)
    count = len(depth)
    return PlainGaussians(
        means=np.stack([x * depth, y * depth, depth], axis=1).astype(np.float32),
        log_scales=np.log(np.repeat(depth[:, None] / FOCAL, 3, axis=1)).astype(np.float32),
        quaternions=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        logits=np.full(count, 3.0, np.float32),
        sh=np.zeros((count, 1, 3), np.float32),
    )


def test_the_photo_s_own_camera_is_first_and_others_are_near_it() -> None:
    w2c = np.eye(4)
    w2c[:3, 3] = (0.5, 0.0, 1.0)
    own = PhotoCamera(192, 128, np.array([[160.0, 0, 96], [0, 160, 64], [0, 0, 1]]), w2c)
    views, _ = of_one_photo(SplatFile((pixels_of(),), photo=own), None, 20, 96)
    assert views is not None
    first = views.cameras[0]
    assert (first.width, first.height, first.fx) == (96, 64, 80)
    assert first.w2c == pytest.approx(w2c)
    away = [np.linalg.norm(camera.position - first.position) for camera in views.cameras]
    nearest = NEAR + 1.0
    assert 0 < np.median(away) <= max(away) < 1.5 * REACH * nearest
    assert len(views.cameras) == 20
    assert views.up == (0, -1, 0)
    assert "the file has it" in views.lines[0]


@pytest.mark.parametrize("up", [(0.0, -1.0, 0.0), (0.0, 1.0, 0.0)])
def test_a_file_that_has_no_camera_shows_one_picture_from_the_origin(
    up: tuple[float, float, float],
) -> None:
    """As converted to another format: y down, or turned to y up as in SPZ."""
    given = pixels_of()
    if up[1] > 0:
        given = replace(given, means=given.means * np.array([1, -1, -1], np.float32))
    views, _ = of_one_photo(SplatFile((given,), up=up), None, 20, 96)
    assert views is not None
    first = views.cameras[0]
    assert first.position == pytest.approx(np.zeros(3))
    assert first.forward[2] == -up[1]
    assert views.up == up
    assert (first.width, first.height) == pytest.approx((96, 64), abs=1)
    assert first.fx == pytest.approx(FOCAL, rel=0.03)
    # All but the outermost pixels, which are a twentieth of so small a picture.
    assert first.framed(given.means.astype(float)).which.mean() > 0.94
    assert "fill one picture" in views.lines[0]


def test_a_camera_that_sees_little_of_the_splats_is_passed_over_and_said() -> None:
    """They were moved since: an editor left the camera where it was."""
    turned = np.diag([1.0, -1.0, -1.0, 1.0])
    own = PhotoCamera(192, 128, np.array([[160.0, 0, 96], [0, 160, 64], [0, 0, 1]]), turned)
    views, notes = of_one_photo(SplatFile((pixels_of(),), photo=own), None, 20, 96)
    assert views is not None and "fill one picture" in views.lines[0]
    assert notes == ["not used: the photo's camera in the file, which sees little of it"]


def test_up_is_what_somebody_or_the_file_says() -> None:
    file = SplatFile((pixels_of(),), up=(0.0, 0.0, 1.0), up_said=True)
    said, _ = of_one_photo(file, None, 20, 96)
    asked, _ = of_one_photo(file, (1.0, 0.0, 0.0), 20, 96)
    assert said is not None and said.up == (0, 0, 1)
    assert asked is not None and asked.up == (1, 0, 0)


@pytest.mark.parametrize("name", SCENES)
def test_scenes_of_many_photos_are_not_taken_for_one(name: str) -> None:
    """Even where all of them lies on one side of the origin."""
    given = SCENES[name]().gaussians
    for shift in ((0.0, 0.0, 0.0), (0.0, 0.0, 1.2 * float(np.ptp(given.means, axis=0).max()))):
        moved = replace(given, means=given.means + np.array(shift, np.float32))
        assert of_one_photo(SplatFile((moved,)), None, 20, 96) == (None, [])


def test_half_a_picture_is_none() -> None:
    """An object that was cut out of it leaves corners empty: it may be of many photos."""
    given = pixels_of()
    ball = given.means[:, 2] < FAR
    cut = PlainGaussians(*(getattr(given, name)[ball] for name in vars(given)))
    assert of_one_photo(SplatFile((cut,)), None, 20, 96) == (None, [])
