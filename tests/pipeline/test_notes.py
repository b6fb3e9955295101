"""The tiny picture in a file is the photo of the first view."""

import io

import numpy as np
import pytest
from PIL import Image, features

from gsynopsis.cli.poster import SIDE, poster_of
from gsynopsis.pack.poster import parse_poster
from tests.tiny import tiny_scene


@pytest.mark.skipif(not features.check("webp"), reason="Pillow without WebP: no posters")
def test_a_poster_is_a_photo_made_small_in_few_bytes() -> None:
    scene = tiny_scene(size=(96, 64))
    data = parse_poster(poster_of(scene, scene.train[1]))
    assert data is not None and len(data) <= 512
    picture = Image.open(io.BytesIO(data)).convert("RGB")
    assert picture.size == (SIDE, SIDE * 64 // 96)
    photo = scene.image(scene.train[1], 2)
    assert np.abs(np.asarray(picture, float) - photo).mean() < 12


def test_photos_smaller_than_a_poster_stay_as_they_are() -> None:
    scene = tiny_scene(size=(24, 16))
    data = parse_poster(poster_of(scene, scene.train[0]))
    assert data is not None
    assert Image.open(io.BytesIO(data)).size == (24, 16)
