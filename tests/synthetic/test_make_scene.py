"""Procedural scenes take the road of real ones and are what they say."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from gsynopsis.errors import SettingError
from gsynopsis.scene.camera import look_at
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene
from gsynopsis.synthetic import city
from gsynopsis.synthetic import make_scene as synthetic
from gsynopsis.synthetic.make_scene import UP, make_scene

TINY = {"views": 3, "width": 24, "height": 16, "points": 20}


def digest(folder: Path) -> str:
    total = hashlib.sha256()
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        total.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return total.hexdigest()


def colors_off(scene: Scene, kind: synthetic.Kind, shift: float = 0) -> np.ndarray:
    """How far the colours of visible points are from the pixels they fall on, of 255.

    Args:
        scene: A synthetic scene of 10 views.
        kind: Its kind.
        shift: Pixels to look aside, along both axes.
    """
    recipe = synthetic.SyntheticScene(kind, 10, 96, 64, 0, 500)
    world, _ = synthetic.world_and_cameras(recipe)
    off: list[np.ndarray] = []
    for number in range(10):
        camera = scene.camera(number, 1)
        x, y, z = camera.w2c[:3, :3] @ scene.points.T + camera.w2c[:3, 3:]
        with np.errstate(all="ignore"):
            pixels = np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], 1)
        inside = (z > 0) & (pixels > 4).all(axis=1) & (pixels < [92, 60]).all(axis=1)
        rays = synthetic.camera_rays(camera, pixels[inside])
        reach = np.linalg.norm(scene.points[inside] - camera.position, axis=1)
        visible = np.abs(synthetic.trace(world, rays, 0.01, 0)[1] - reach) < 1e-3 * reach
        u, v = (pixels[inside][visible] + shift).astype(int).T
        seen = scene.image(number, 1)[v, u].astype(int)
        off.append(np.abs(seen - scene.colors[inside][visible].astype(int)).max(axis=1))
    return np.concatenate(off)


@pytest.mark.parametrize("name", ["small_room", "small_garden"])
def test_a_procedural_scene_loads_like_any_other(request, name):
    scene = load_scene(request.getfixturevalue(name))
    assert len(scene.views) == 10 and scene.points.shape == (500, 3)
    assert scene.test == (0, 8) and scene.image(0, 1).shape == (64, 96, 3)
    assert 2 < scene.extent < 4.5
    theirs = pycolmap.Reconstruction(scene.root / "sparse" / "0")
    assert theirs.num_images() == 10 and theirs.num_points3D() == 500


@pytest.mark.parametrize(("name", "kind"), [("small_room", "room"), ("small_garden", "outdoor")])
def test_a_visible_point_projects_onto_its_colour(request, name, kind):
    scene = load_scene(request.getfixturevalue(name))
    off = colors_off(scene, kind)
    # Measured: a median of 4 where it falls, 13 to 15 a pixel beside it, on all sides alike.
    assert len(off) > 900 and np.median(off) < 8
    for shift in (-1, 1):
        assert np.median(colors_off(scene, kind, shift)) > 2 * np.median(off)


def test_the_garden_has_a_background_30_times_farther_than_its_cameras(small_garden):
    scene = load_scene(small_garden)
    distance = np.linalg.norm(scene.points, axis=1)
    ring = np.mean([np.linalg.norm(view.camera.position[:2]) for view in scene.views])
    assert ring == pytest.approx(3.0, rel=0.05)
    assert ((distance > 30 * ring) & (distance < 80 * ring)).sum() > 20
    assert (distance < 2 * ring).sum() > 200


def test_the_room_encloses_its_cameras(small_room):
    scene = load_scene(small_room)
    assert (np.abs(scene.points) <= np.array([3.5, 3.0, 2.8]) + 1e-4).all()
    assert scene.points[:, 2].min() > -1e-4
    for view in scene.views:
        assert (np.abs(view.camera.position) < [2.5, 2.5, 2.5]).all()


def test_the_shiny_ball_changes_with_the_view(small_room):
    scene = load_scene(small_room)
    ball = np.linalg.norm(scene.points - [0.02, 0.05, 1.01], axis=1) < 0.28
    assert ball.sum() >= 5
    world, cameras = synthetic.world_and_cameras(
        synthetic.SyntheticScene("room", 10, 96, 64, 0, 500)
    )
    spot = np.array([0.02, 0.05, 1.01 + 0.27])
    seen = []
    for camera in cameras:
        ray = spot - camera.position
        rays = (camera.position[:, None], (ray / np.linalg.norm(ray))[:, None])
        rays = (rays[0].astype(np.float32), rays[1].astype(np.float32))
        seen.append(synthetic.trace(world, rays, 0.01, 0)[0][:, 0])
    assert np.ptp(seen, axis=0).max() > 0.1


def test_a_city_has_a_block_for_about_ten_photos_and_cameras_over_its_streets():
    recipe = synthetic.SyntheticScene("city", 400, 24, 16, 1, 1)
    assert city.grid_of(recipe.views) == (8, 5)
    world, cameras = synthetic.world_and_cameras(recipe)
    block_centers = np.array(city.block_centers((8, 5)))
    houses = [surface.bound for surface in world.surfaces if surface.bound is not None]
    assert len(block_centers) == 40 and len(houses) > 200
    for camera in cameras:
        beside = np.abs(camera.position[:2] - block_centers).max(axis=1).min()
        assert 9.0 < camera.position[2] < 17.0
        # No camera stands in a house: the middles of streets are half a pitch from those of blocks.
        assert beside > city.PITCH / 2 - 1.5


@pytest.mark.parametrize("kind", ["room", "outdoor", "object", "city"])
def test_the_same_seed_gives_the_same_bytes_and_another_does_not(tmp_path, kind):
    one = digest(make_scene(kind, tmp_path / "one", **TINY))
    assert digest(make_scene(kind, tmp_path / "two", **TINY)) == one
    assert digest(make_scene(kind, tmp_path / "three", seed=1, **TINY)) != one


def test_an_earlier_output_is_replaced_and_nothing_else_is_left(tmp_path):
    out = make_scene("room", tmp_path / "scene", **TINY)
    first = digest(out)
    make_scene("outdoor", out, **TINY | {"views": 2})
    assert json.loads((out / "synthetic.json").read_text())["kind"] == "outdoor"
    assert sorted(p.name for p in (out / "images").iterdir()) == ["view_0000.png", "view_0001.png"]
    assert digest(out) != first and [p.name for p in tmp_path.iterdir()] == ["scene"]


def test_an_empty_folder_is_used(tmp_path):
    (tmp_path / "scene").mkdir()
    assert len(load_scene(make_scene("room", tmp_path / "scene", **TINY)).views) == 3


def test_it_tells_how_many_photos_there_are(tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    make_scene("room", tmp_path / "scene", **TINY, tick=lambda *counts: told.append(counts))
    assert told == [(1, 3), (2, 3), (3, 3)]


@pytest.mark.parametrize("extra", ["notes.txt", "images/holiday.jpg", "run/model.gsyn"])
def test_a_folder_with_anything_else_in_it_is_refused_and_untouched(tmp_path, extra):
    out = make_scene("room", tmp_path / "scene", **TINY)
    (out / extra).parent.mkdir(exist_ok=True)
    (out / extra).write_text("mine")
    before = digest(out)
    with pytest.raises(SettingError, match="found a folder with other files, expected a new or"):
        make_scene("room", out, **TINY)
    assert digest(out) == before and [p.name for p in tmp_path.iterdir()] == ["scene"]


def test_a_real_scene_or_a_file_is_never_overwritten(tiny, tmp_path):
    root = tiny()
    before = digest(root)
    with pytest.raises(SettingError, match="found a folder with other files"):
        make_scene("room", root, **TINY)
    assert digest(root) == before
    with pytest.raises(SettingError, match="found a file, expected a new or empty folder"):
        make_scene("room", root / "images" / "a.png", **TINY)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"kind": "moon"}, "kind: found moon, expected room or outdoor or object"),
        ({"views": 1}, "views: found 1, expected 2 to 10000"),
        ({"width": 0}, "width: found 0, expected 1 to 4096"),
        ({"points": 0}, "points: found 0, expected 1 to 10000000"),
        ({"seed": -1}, "seed: found -1, expected 0 to"),
    ],
)
def test_an_impossible_recipe_is_refused(tmp_path, changed, words):
    recipe = {"kind": "room", "out": tmp_path / "scene", **TINY} | changed
    with pytest.raises(SettingError, match=words):
        make_scene(**recipe)
    assert not (tmp_path / "scene").exists()


def test_a_full_disk_is_said_and_leaves_nothing(tmp_path, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(synthetic, "write_binary", full)
    with pytest.raises(synthetic.SpaceError, match="found a full disk, expected room for the ph"):
        make_scene("room", tmp_path / "scene", **TINY)
    assert list(tmp_path.iterdir()) == []


def test_a_camera_that_looks_at_a_target_has_it_in_its_middle_and_stands_upright():
    w2c = look_at(np.array([2.0, 1.0, 3.0]), np.array([0.0, 0.0, 1.0]), UP)
    np.testing.assert_allclose(w2c[:3, :3] @ w2c[:3, :3].T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose((w2c @ [0, 0, 1, 1])[:3], [0, 0, 3], atol=1e-14)
    # Up in the world is up in the picture: smaller y.
    assert (w2c @ [0, 0, 2, 1])[1] < 0


def test_an_object_stands_before_one_colour_that_has_no_points(tmp_path):
    scene = load_scene(make_scene("object", tmp_path / "object", views=4, width=48, height=48))
    corners = np.stack([scene.image(view)[[0, 0, -1, -1], [0, -1, 0, -1]] for view in range(4)])
    assert len(np.unique(corners.reshape(-1, 3), axis=0)) == 1
    assert scene.image(0)[24, 24].tolist() != corners[0, 0].tolist()
    assert 100 < len(scene.points) < 6000
    assert np.linalg.norm(scene.points - scene.points.mean(axis=0), axis=1).max() < 0.7
