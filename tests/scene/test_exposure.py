"""Exposure that differs is told from what only looks like it."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsynopsis.scene.exposure import AGREEMENT, UNPREDICTED, exposure_evidence
from gsynopsis.scene.load import load_scene

Change = Callable[[int, np.ndarray], np.ndarray]


@pytest.fixture
def changed(small_room: Path, tmp_path: Path) -> Callable[[Change], Path]:
    """Makes the procedural room with photos changed by their number in order of names."""

    def make(change: Change) -> Path:
        out = tmp_path / "changed"
        shutil.copytree(small_room, out)
        for number, path in enumerate(sorted((out / "images").iterdir())):
            with Image.open(path) as photo:
                pixels = change(number, np.asarray(photo, np.float64).copy())
            Image.fromarray(np.rint(pixels.clip(0, 255)).astype(np.uint8)).save(path)
        return out

    return make


def made_up(count: int) -> np.ndarray:
    """Gains of photos, independent of one another, [V, 3]."""
    rng = np.random.default_rng(5)
    return rng.uniform(0.65, 1.1, (count, 1)) * rng.uniform(0.9, 1.05, (count, 3))


def test_made_up_gains_are_found_and_the_original_has_none(small_room, changed) -> None:
    original = load_scene(small_room, "none")
    gains = made_up(len(original.views))
    scene = load_scene(changed(lambda number, pixels: pixels * gains[number]), "none")
    wanted, found = np.log(gains), exposure_evidence(scene)
    assert found.gains == pytest.approx(wanted - wanted.mean(axis=0), abs=0.06)
    assert found.sufficient, found
    assert not exposure_evidence(original).sufficient
    assert exposure_evidence(original).spread < 0.02


def test_gains_that_follow_the_way_of_the_camera_are_left_to_the_colour_heads(changed) -> None:
    scene = load_scene(changed(lambda n, pixels: pixels * (0.7 + 0.25 * np.sin(n / 4))), "none")
    found = exposure_evidence(scene)
    assert found.spread > UNPREDICTED
    assert not found.sufficient and "predict" in found.rejection


def covered_below(number: int, pixels: np.ndarray) -> np.ndarray:
    if number % 2:
        pixels[len(pixels) // 2 :] = pixels[len(pixels) // 2 :] * 0.2 + [150, 20, 20]
    return pixels


def covered_at_the_right(number: int, pixels: np.ndarray) -> np.ndarray:
    if number % 3 == 1:
        pixels[:, pixels.shape[1] // 2 :] *= [0.3, 0.9, 0.4]
    return pixels


def covered_in_the_middle(number: int, pixels: np.ndarray) -> np.ndarray:
    if number % 2:
        high, wide = pixels.shape[:2]
        pixels[high // 7 : -high // 7, wide // 7 : -wide // 7] *= [0.4, 0.4, 1.0]
    return pixels


def vignetted(number: int, pixels: np.ndarray) -> np.ndarray:
    high, wide = pixels.shape[:2]
    y, x = np.mgrid[-1 : 1 : high * 1j, -1 : 1 : wide * 1j]
    return pixels * (1 - 0.3 * (x**2 + y**2))[:, :, None]


def lit(number: int, pixels: np.ndarray) -> np.ndarray:
    rng = np.random.default_rng(number)
    high, wide = pixels.shape[:2]
    y, x = np.mgrid[:high, :wide]
    for column, row in rng.uniform(0, [wide, high], (4, 2)):
        square = (x - column) ** 2 + (y - row) ** 2
        pixels += 250 * np.exp(-square / (2 * (wide / 14) ** 2))[:, :, None]
    return pixels


@pytest.mark.parametrize(
    "change", [covered_below, covered_at_the_right, covered_in_the_middle, vignetted, lit]
)
def test_what_changes_a_part_of_photos_is_no_exposure(changed, change) -> None:
    found = exposure_evidence(load_scene(changed(change), "none"))
    assert not found.sufficient, found


def test_points_behind_a_mask_say_nothing(changed) -> None:
    """Outside of the masks photos differ, inside they do not."""
    half = made_up(16)

    def change(number: int, pixels: np.ndarray) -> np.ndarray:
        pixels[:, : pixels.shape[1] // 3] *= half[number]
        return pixels

    folder = changed(change)
    (folder / "masks").mkdir()
    for path in (folder / "images").iterdir():
        with Image.open(path) as photo:
            mask = np.full((photo.height, photo.width), 255, np.uint8)
        mask[:, : mask.shape[1] // 3 + 1] = 0
        Image.fromarray(mask).save(folder / "masks" / f"{path.stem}.png")
    found = exposure_evidence(load_scene(folder, "none"))
    assert found.spread < 0.02 and not found.sufficient


@pytest.mark.parametrize("name", ["fox", "brighton", "alexander"])
def test_real_scenes_have_no_sufficient_evidence(real_scene, name) -> None:
    found = exposure_evidence(load_scene(real_scene(name)))
    assert not found.sufficient, found


def test_made_up_gains_of_a_real_scene_are_sufficient_evidence(real_scene, tmp_path) -> None:
    source = real_scene("brighton")
    scene = load_scene(source)
    gains = made_up(len(scene.views))
    shutil.copytree(source / "sparse", tmp_path / "scene" / "sparse")
    (tmp_path / "scene" / "images").mkdir()
    for number, view in enumerate(scene.views):
        with Image.open(view.path) as photo:
            pixels = np.rint((np.asarray(photo) * gains[number]).clip(0, 255)).astype(np.uint8)
        Image.fromarray(pixels).save(tmp_path / "scene" / "images" / view.path.name, quality=95)
    found = exposure_evidence(load_scene(tmp_path / "scene"))
    assert found.sufficient and found.agreement > (1 + AGREEMENT) / 2
