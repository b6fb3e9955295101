"""Scenes: splits, sizes, extent, identity and bad folders."""

import dataclasses

import numpy as np
import pytest

from gsynopsis.scene.load import load_scene


@pytest.mark.parametrize(
    ("name", "views", "test"), [("fox", 50, 7), ("brighton", 18, 3), ("bonsai", 289, 37)]
)
def test_every_eighth_view_of_a_real_scene_is_held_out(real_scene, name, views, test):
    scene = load_scene(real_scene(name))
    assert len(scene.views) == views and len(scene.test) == test
    assert scene.test == tuple(range(0, views, 8))
    assert sorted(scene.train + scene.test) == list(range(views))
    assert [v.name for v in scene.views] == sorted(v.name for v in scene.views)


@pytest.mark.parametrize("factor", [1, 2, 4, 8])
def test_image_and_camera_of_a_real_scene_agree_at_each_size(real_scene, factor):
    scene = load_scene(real_scene("fox"))
    camera, image = scene.camera(3, factor), scene.image(3, factor)
    full = scene.views[3].camera
    assert image.shape == (round(946 / factor), round(530 / factor), 3)
    assert (camera.height, camera.width) == image.shape[:2]
    # The principal point and the focal length stay where they are relative to the image.
    assert camera.cx / camera.width == pytest.approx(full.cx / full.width, rel=1e-14)
    assert camera.cy / camera.height == pytest.approx(full.cy / full.height, rel=1e-14)
    assert camera.fx / camera.width == pytest.approx(full.fx / full.width, rel=1e-14)


def test_a_shift_moves_the_principal_point_and_nothing_else(tiny):
    scene = load_scene(tiny())
    usual, shifted = scene.camera(0, 2), scene.camera(0, 2, (0.25, -0.5))
    assert (shifted.cx, shifted.cy) == (usual.cx - 0.25, usual.cy + 0.5)
    for name in ("width", "height", "fx", "fy"):
        assert getattr(shifted, name) == getattr(usual, name)
    assert np.array_equal(shifted.w2c, usual.w2c)
    assert scene.image(0, 2, (0.25, -0.5)).shape == scene.image(0, 2).shape
    assert not np.array_equal(scene.image(0, 2, (0.25, -0.5)), scene.image(0, 2))


def test_a_principal_point_off_the_middle_is_honoured_and_scaled(tiny):
    scene = load_scene(tiny())
    assert (scene.camera(0, 1).cx, scene.camera(0, 1).cy) == (5.5, 5.25)
    assert (scene.camera(0, 2).cx, scene.camera(0, 2).cy) == (2.75, 2.625)


def test_views_are_sorted_and_keyed_by_their_full_name(tiny):
    scene = load_scene(tiny(("right/a.1.png", "left/a.2.png", "left/a.1.png", "a.png")))
    assert [v.name for v in scene.views] == [
        "a.png",
        "left/a.1.png",
        "left/a.2.png",
        "right/a.1.png",
    ]
    first, second = scene.image(1, 1), scene.image(2, 1)
    assert not np.array_equal(first, second)


def test_an_image_is_loaded_once(tiny):
    scene = load_scene(tiny())
    image = scene.image(1, 2)
    assert scene.image(1, 2) is image and not image.flags.writeable


def test_extent_is_the_largest_distance_from_the_mean_training_camera_and_a_tenth(tiny):
    scene = load_scene(tiny([f"{i}.png" for i in range(9)]))
    places = np.stack([scene.views[i].camera.position for i in scene.train])
    middle = places.sum(axis=0) / 7
    assert scene.extent == pytest.approx(1.1 * max(np.linalg.norm(p - middle) for p in places))
    assert len(places) == 7


def test_extent_of_one_training_camera_is_that_of_all(tiny):
    scene = load_scene(tiny(["a.png", "b.png"]))
    assert len(scene.train) == 1 and scene.extent > 0


def test_the_fingerprint_is_that_of_the_input_and_not_of_its_place_or_split(tiny, tmp_path):
    root = tiny()
    scene = load_scene(root)
    root.rename(tmp_path / "moved")
    moved = load_scene(tmp_path / "moved", "none")
    assert scene.fingerprint() == moved.fingerprint() and len(scene.fingerprint()) == 64


@pytest.mark.parametrize("what", ["name", "focal", "pose", "point", "color"])
def test_the_fingerprint_changes_with_each_part_of_the_input(tiny, what):
    scene = load_scene(tiny())
    view = scene.views[0]
    points, colors, w2c = scene.points.copy(), scene.colors.copy(), view.camera.w2c.copy()
    points[2, 1] += 1e-6
    colors[2, 1] ^= 1
    w2c[0, 3] += 1e-6
    moved = dataclasses.replace(view, camera=dataclasses.replace(view.camera, w2c=w2c))
    longer = dataclasses.replace(view, camera=dataclasses.replace(view.camera, fx=11.001))
    renamed = dataclasses.replace(view, name="aa.png")
    changed = {
        "name": {"views": (renamed, *scene.views[1:])},
        "focal": {"views": (longer, *scene.views[1:])},
        "pose": {"views": (moved, *scene.views[1:])},
        "point": {"points": points},
        "color": {"colors": colors},
    }[what]
    assert dataclasses.replace(scene, **changed).fingerprint() != scene.fingerprint()
