"""Masks say which pixels and points count."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsynopsis.errors import SceneError
from gsynopsis.scene.masks import check_masks, points_inside
from gsynopsis.scene.scene import Reading, load_scene
from tests.scene.tiny_models import SIZE

EMPTY = Reading(masks="empty")


def write_mask(path: Path, white: slice, size: tuple[int, int] = SIZE) -> None:
    pixels = np.zeros((size[1], size[0]), np.uint8)
    pixels[:, white] = 255
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path)


def test_masks_are_found_under_both_names_and_counted(tiny) -> None:
    root = tiny(("a.png", "b.png", "c.png"))
    write_mask(root / "masks" / "a.png", slice(0, 6))
    write_mask(root / "masks" / "b.png.png", slice(6, 12))
    scene = load_scene(root)
    assert "masks of 2 of 3 photos; photos without one count whole" in scene.notes
    assert scene.masked and scene.mask(2) is None and scene.inside(2) is None
    first, second = scene.mask(0), scene.mask(1)
    assert first is not None and second is not None
    assert (first[:, :6] == 1).all() and (first[:, 6:] == 0).all()
    assert np.array_equal(second, 1 - first)
    assert not load_scene(root, reading=Reading(masks="off")).masked


def test_a_mask_goes_the_way_of_its_photo(tiny) -> None:
    root = tiny(("a.png", "b.png", "c.png"))
    write_mask(root / "masks" / "a.png", slice(0, 24), (24, 20))  # twice the photo's size
    scene = load_scene(root)
    for factor in (1, 2, 3):
        mask, image = scene.mask(0, factor), scene.image(0, factor)
        assert mask is not None and mask.shape == image.shape[:2] and (mask == 1).all()


def test_empty_blackens_photos_and_leaves_out_points_outside(small_room: Path) -> None:
    usual = load_scene(small_room)
    width, height = usual.views[0].camera.width, usual.views[0].camera.height
    masks = small_room / "masks"
    try:
        for view in usual.views:
            write_mask(masks / view.name, slice(width // 4, 3 * width // 4), (width, height))
        scene, same = load_scene(small_room, reading=EMPTY), load_scene(small_room)
        assert (scene.image(0)[:, : width // 4] == 0).all()
        middle = slice(width // 4, 3 * width // 4)
        assert np.array_equal(scene.image(0)[:, middle], usual.image(0)[:, middle])
        assert np.array_equal(same.image(0), usual.image(0))
        kept = points_inside(same)
        assert 0 < kept.sum() < len(kept)
        assert np.array_equal(scene.points, usual.points[kept])
        assert any("points lie outside the masks" in note for note in scene.notes)
    finally:
        for path in masks.iterdir():
            path.unlink()
        masks.rmdir()


def test_a_mask_of_another_shape_or_black_or_of_no_photo_is_refused(tiny) -> None:
    root = tiny(("a.png", "b.png", "c.png"))
    write_mask(root / "masks" / "x.png", slice(0, 6))
    with pytest.raises(SceneError, match="masks: found no mask of any photo, expected files such"):
        load_scene(root)
    write_mask(root / "masks" / "a.png", slice(0, 6), (12, 12))
    with pytest.raises(SceneError, match=r"a\.png: mask size: found 12x12, expected 12x10 as its"):
        load_scene(root)
    write_mask(root / "masks" / "a.png", slice(0, 0))
    with pytest.raises(SceneError, match=r"a\.png: mask: found black all over, expected white"):
        list(check_masks(load_scene(root)))
    with pytest.raises(SceneError, match=r"found none of 7 points inside the masks"):
        load_scene(root, reading=EMPTY)


@pytest.mark.parametrize("folder", ["images_2", "images_4"])
def test_smaller_copies_of_the_photos_have_smaller_cameras(small_room: Path, folder: str) -> None:
    factor = int(folder[-1])
    usual = load_scene(small_room)
    (small_room / folder).mkdir(exist_ok=True)
    for view in usual.views:
        with Image.open(view.path) as photo:
            photo.resize((96 // factor, 64 // factor)).save(small_room / folder / view.name)
    scene = load_scene(small_room, reading=Reading(images=folder))
    assert scene.camera(0).fx == pytest.approx(usual.camera(0).fx / factor)
    assert (scene.camera(0).width, scene.camera(0).height) == (96 // factor, 64 // factor)
    with pytest.raises(SceneError, match="images_9: found no such folder"):
        load_scene(small_room, reading=Reading(images="images_9"))


def test_a_masked_scene_has_no_backdrop(tiny) -> None:
    root = tiny(("a.png", "b.png", "c.png"))
    assert len(load_scene(root).backdrop) > 0
    write_mask(root / "masks" / "a.png", slice(0, 6))
    assert load_scene(root).backdrop.shape == (0, 3)
    assert len(load_scene(root, reading=Reading(masks="off")).backdrop) > 0
