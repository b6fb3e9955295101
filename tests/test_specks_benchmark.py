"""What benchmarks/train/specks.py counts: holes and specks, and no soft image."""

import numpy as np
import torch
from scipy import ndimage

from benchmarks.train.specks import COLUMNS, measure
from gsynopsis.render.base import Rendering

LEVELS_BELOW = 3


def counts(picture: np.ndarray) -> dict[str, float]:
    photo = np.full((60, 80, 3), 90, np.uint8)
    photo[:, 40:] = 160
    none = torch.zeros(0, dtype=torch.bool)
    image = torch.from_numpy(picture).float() / 255
    drawn = Rendering(image, torch.ones(60, 80), none, lambda: torch.zeros(0, 2))
    return dict(zip(COLUMNS, measure(drawn, photo, LEVELS_BELOW), strict=True))


def two_halves() -> np.ndarray:
    picture = np.full((60, 80, 3), 90, np.uint8)
    picture[:, 40:] = 160
    return picture


def test_a_soft_image_has_neither_holes_nor_specks() -> None:
    soft = ndimage.gaussian_filter(two_halves().astype(float), (4, 4, 0)).astype(np.uint8)
    found = counts(soft)
    assert [found[name] for name in COLUMNS[1:]] == [0, 0, 0, 0, 0]


def test_a_hole_and_a_speck_are_counted_by_their_pixels() -> None:
    picture = two_halves()
    picture[10:14, 10:15] = 0
    picture[30:33, 60:62] = 255
    found = counts(picture)
    pixels = 60 * 80 / 1000
    assert np.isclose(found["beyond_dark"], 20 / pixels)
    assert np.isclose(found["beyond_bright"], 6 / pixels)
    assert np.isclose(found["blurred_dark"], 20 / pixels)
