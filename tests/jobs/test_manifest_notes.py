"""The tiny picture in a file is the photo of the first view."""

import io

import numpy as np
import pytest
from PIL import Image, features

from gsynopsis.container.notes.poster import parse_poster
from gsynopsis.evaluation.report import AtPhotoSize
from gsynopsis.jobs.manifest_notes import POSTER_SIDE, poster_of, quality_notes
from tests.tiny import tiny_scene


@pytest.mark.skipif(not features.check("webp"), reason="Pillow without WebP: no posters")
def test_a_poster_is_a_photo_made_small_in_few_bytes() -> None:
    scene = tiny_scene(size=(96, 64))
    data = parse_poster(poster_of(scene.image(scene.train[1])))
    assert data is not None and len(data) <= 512
    picture = Image.open(io.BytesIO(data)).convert("RGB")
    assert picture.size == (POSTER_SIDE, POSTER_SIDE * 64 // 96)
    photo = scene.image(scene.train[1], 2)
    assert np.abs(np.asarray(picture, float) - photo).mean() < 12


def test_photos_smaller_than_a_poster_stay_as_they_are() -> None:
    scene = tiny_scene(size=(24, 16))
    data = parse_poster(poster_of(scene.image(scene.train[0])))
    assert data is not None
    assert Image.open(io.BytesIO(data)).size == (24, 16)


def test_a_file_says_how_its_figures_were_measured() -> None:
    notes = quality_notes("every8", 2.0, (48, 32), AtPhotoSize(96, 64, 2, 3))
    assert (notes["pictures"], notes["photos"]) == ("48 x 32", "96 x 64")
    assert "by rule every8, scale 2, 8 bits, black background" in notes["protocol"]
    assert "photo: 96 x 64, the photos' own size, 2 of 3 views" in notes["protocol"]
    assert "photos" not in quality_notes("every8", 2.0, (48, 32), None)
