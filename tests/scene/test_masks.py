"""Masks say which pixels and points count."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsynopsis.errors import SceneError
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.masks import MaskUse, check_masks, points_inside
from gsynopsis.scene.scene import SceneOptions
from tests.scene.tiny_models import SIZE

EMPTY, ALPHA = SceneOptions(masks="empty"), SceneOptions(masks="alpha")


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
    assert not load_scene(root, reading=SceneOptions(masks="off")).masked


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
        kept = points_inside(same.points, [same.views[view] for view in same.train])
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
        list(check_masks(load_scene(root).views))
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
    scene = load_scene(small_room, reading=SceneOptions(images=folder))
    assert scene.camera(0).fx == pytest.approx(usual.camera(0).fx / factor)
    assert (scene.camera(0).width, scene.camera(0).height) == (96 // factor, 64 // factor)
    with pytest.raises(SceneError, match="images_9: found no such folder"):
        load_scene(small_room, reading=SceneOptions(images="images_9"))


def test_a_masked_scene_has_no_backdrop(tiny) -> None:
    root = tiny(("a.png", "b.png", "c.png"))
    assert len(load_scene(root).backdrop) > 0
    write_mask(root / "masks" / "a.png", slice(0, 6))
    assert load_scene(root).backdrop.shape == (0, 3)
    assert len(load_scene(root, reading=SceneOptions(masks="off")).backdrop) > 0


@pytest.mark.parametrize("folder", ["mask", "Masks"])
@pytest.mark.parametrize("name", ["a.PNG", "A.png", "a_mask.png", "a.mask.jpg", "a.png.mask.png"])
def test_masks_have_the_names_that_other_programs_give(tiny, folder: str, name: str) -> None:
    root = tiny(("a.png", "b.png", "c.png"))
    write_mask(root / folder / "made.png", slice(0, 6))
    (root / folder / "made.png").rename(root / folder / name)
    scene = load_scene(root)
    assert [view.mask and view.mask.name for view in scene.views] == [name, None, None]
    assert f"masks: 1 of 3 photos, in {folder}/; photos without one c" in scene.account.text()
    off = load_scene(root, reading=SceneOptions(masks="off"))
    assert not off.masked and off.account.masks == "not looked at, as asked"


def listed_masks(root: Path, names: dict[str, object], **top: object) -> Path:
    """A scene of a COLMAP model as transforms.json, with `mask_path` by photo."""
    colmap = load_scene(root)
    c, frames = colmap.views[0].camera, list[dict[str, object]]()
    for view in colmap.views:
        c2w = np.linalg.inv(view.camera.w2c) * [1, -1, -1, 1]
        frame = {"file_path": f"images/{view.name}", "transform_matrix": c2w.tolist()}
        frames.append(frame | ({"mask_path": names[view.name]} if view.name in names else {}))
    values = {"fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy, **top, "frames": frames}
    (root / "transforms.json").write_text(json.dumps(values))
    (root / "sparse").rename(root / "elsewhere")
    return root


def test_masks_that_frames_name_count_and_a_folder_beside_is_named(tiny) -> None:
    root = listed_masks(
        tiny(("a.png", "b.png", "c.png")),
        {"a.png": "object\\a.png", "b.png": "images/b_cut.PNG", "c.png": None},
    )
    write_mask(root / "object" / "a.png", slice(0, 6))
    write_mask(root / "images" / "b_cut.png", slice(6, 12), (24, 20))
    write_mask(root / "masks" / "a.png", slice(0, 1))
    scene = load_scene(root)
    first, second = scene.mask(0), scene.mask(1)
    assert first is not None and second is not None and scene.mask(2) is None
    assert (first[:, :6] == 1).all() and (first[:, 6:] == 0).all() and second.shape == first.shape
    told = scene.account.text()
    assert "2 of 3 photos, named by transforms.json; photos without one count whole" in told
    assert "masks/ is not read" in told
    assert not load_scene(root, reading=SceneOptions(masks="off")).masked


@pytest.mark.parametrize(
    ("mask", "words"),
    [
        ("gone.png", r"gone\.png: image: found no such file"),
        ("../a.png", r"transforms\.json: image name: found '\.\./a\.png'"),
        (["a.png"], r"frame 0: mask_path: found \['a\.png'\], expected a text"),
        ("pipe.png", r"pipe\.png: found a pipe, expected a photo"),
        ("wide.png", r"wide\.png: mask size: found 30x10, expected 12x10"),
    ],
)
def test_a_mask_that_is_named_and_cannot_be_is_one_line(tiny, mask: object, words: str) -> None:
    root = listed_masks(tiny(("a.png", "b.png")), {"a.png": mask})
    os.mkfifo(root / "pipe.png")
    write_mask(root / "wide.png", slice(0, 6), (30, 10))
    with pytest.raises(SceneError, match=words) as caught:
        load_scene(root)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["a_mask.png", "a.mask.png", "a.png_mask.png", "a.png.mask.jpg"])
def test_a_mask_may_lie_beside_its_photo(name: str, tiny) -> None:
    root = tiny(("a.png", "b.png", "c.png"))
    write_mask(root / "images" / name, slice(0, 6))
    scene = load_scene(root)
    assert scene.mask(0) is not None and scene.mask(1) is None
    assert "1 of 3 photos, beside the photos" in scene.account.masks
    assert not scene.account.left_out  # it is no photo without a pose


@pytest.mark.parametrize("mode", ["L", "1", "P"])
def test_masks_of_0_and_1_are_black_and_white(mode: str, tiny) -> None:
    root = tiny(("a.png", "b.png", "c.png"))
    pixels = np.zeros((SIZE[1], SIZE[0]), np.uint8)
    pixels[:, :6] = 1
    image = Image.fromarray(pixels)
    if mode == "P":
        image.putpalette([0, 0, 0, 255, 255, 255])
    (root / "masks").mkdir()
    (Image.fromarray(pixels > 0) if mode == "1" else image).save(root / "masks" / "a.png")
    scene = load_scene(root)
    mask = scene.mask(0)
    assert mask is not None
    assert (mask[:, :6] == 1).all() and (mask[:, 6:] == 0).all()
    list(check_masks(scene.views))


def cut_out(path: Path, white: slice) -> None:
    """The photo at a path becomes one with an alpha channel."""
    with Image.open(path) as image:
        photo = image.convert("RGBA")
    alpha = np.zeros((photo.height, photo.width), np.uint8)
    alpha[:, white] = 255
    photo.putalpha(Image.fromarray(alpha))
    photo.save(path)


def test_alpha_channels_are_masks_if_asked(tiny) -> None:
    root = tiny(("a.png", "b.png", "c.png"))
    cut_out(root / "images" / "a.png", slice(0, 6))
    assert not load_scene(root).masked
    scene = load_scene(root, reading=ALPHA)
    mask = scene.mask(0)
    assert mask is not None and (mask[:, :6] == 1).all() and (mask[:, 6:] == 0).all()
    assert "1 of 3 photos, their alpha channels" in scene.account.masks
    small = scene.mask(0, 2)
    assert small is not None and small.shape == scene.image(0, 2).shape[:2]
    write_mask(root / "masks" / "b.png", slice(0, 6))
    both = load_scene(root, reading=ALPHA)
    assert both.mask(1) is None and "masks/ is not read" in both.account.text()


def test_a_model_is_judged_inside_of_masks_unless_their_outside_is_to_be_empty(tiny) -> None:
    root = tiny(("a.png", "b.png", "c.png"))
    assert load_scene(root).judged(0) is None
    write_mask(root / "masks" / "a.png", slice(0, 6))
    scene = load_scene(root)
    inside = scene.judged(0)
    assert inside is not None and inside.sum() == 6 * SIZE[1] and scene.judged(1) is None
    assert replace(scene, reading=EMPTY).judged(0) is None


@pytest.mark.parametrize("use", ["alpha", "empty"])
def test_masks_that_are_asked_for_and_not_there_are_an_error(use: MaskUse, tiny) -> None:
    root = tiny(("a.png", "b.png", "c.png"))
    with pytest.raises(SceneError, match=f"masks: found none, expected .*--masks {use}"):
        load_scene(root, reading=SceneOptions(masks=use))
