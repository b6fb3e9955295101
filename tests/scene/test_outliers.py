"""Points and cameras far outside do not decide the size of a scene, and are counted."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gsynopsis.config import ModelConfig
from gsynopsis.errors import SceneError
from gsynopsis.model.build import make_frame
from gsynopsis.model.lattice import initial_lattice
from gsynopsis.scene.colmap.binary import read_binary, write_binary
from gsynopsis.scene.colmap.model import SparseModel
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.outliers import far_cameras, far_points
from gsynopsis.scene.scene import Scene
from gsynopsis.synthetic.make_scene import make_scene

Edit = Callable[[SparseModel], SparseModel]


@pytest.fixture
def edited(tmp_path: Path) -> Callable[[Path, Edit], Scene]:
    """A scene with the same photos and another sparse model."""

    def load(source: Path, edit: Edit) -> Scene:
        root = tmp_path / source.name
        root.mkdir(exist_ok=True)
        if not (root / "images").exists():
            (root / "images").symlink_to((source / "images").resolve())
        write_binary(root / "sparse" / "0", edit(read_binary(source / "sparse" / "0")))
        return load_scene(root)

    return load


def more_points(count: int, distance: float) -> Edit:
    rng = np.random.default_rng(count)
    ray = rng.standard_normal((count, 3))
    ray *= distance / np.linalg.norm(ray, axis=1, keepdims=True)
    colors = np.zeros((count, 3), np.uint8)
    return lambda model: dataclasses.replace(
        model,
        points=np.concatenate([ray, model.points]),
        colors=np.concatenate([colors, model.colors]),
    )


@pytest.mark.parametrize("extents", [1e2, 1e5, 1e12])
@pytest.mark.parametrize("count", [1, 100])
def test_a_real_scene_with_outliers_is_read_as_the_clean_one(
    real_scene, edited, count: int, extents: float
) -> None:
    """The same points, bit for bit: so training gives the same bytes and loses nothing."""
    source = real_scene("fox")
    clean = load_scene(source)
    scene = edited(source, more_points(count, extents * clean.extent))
    assert scene.fingerprint() == clean.fingerprint()
    total = f"{len(clean.points) + count:,}"
    assert f"{count} of {total} points lie far outside and were left out" in scene.notes
    assert not [note for note in clean.notes if "left out" in note]


@pytest.mark.parametrize("kind", ["room", "outdoor"])
def test_walls_hills_and_skies_are_no_outliers(tmp_path: Path, kind) -> None:
    root = make_scene(kind, tmp_path / kind, views=12, width=48, height=32, points=2000)
    scene = load_scene(root)
    assert len(scene.points) == 2000 and len(scene.train) + len(scene.test) == 12


@pytest.mark.parametrize("bounds", ["contract", "aabb"])
def test_the_frame_is_that_of_the_scene_without_its_outliers(small_room, edited, bounds) -> None:
    config = ModelConfig(bounds=bounds)
    clean = make_frame(load_scene(small_room), config)
    scene = edited(small_room, more_points(5, 1e9))
    frame = make_frame(scene, config)
    assert (frame.voxel, frame.radius, frame.extent) == (clean.voxel, clean.radius, clean.extent)
    assert (frame.center == clean.center).all()


def test_a_hundredth_of_the_points_far_away_does_not_decide_a_box(small_room, edited) -> None:
    """They are too near to be no part of the scene: of bonsai, nine in ten are in a third."""
    config = ModelConfig(bounds="aabb")
    clean = make_frame(load_scene(small_room), config)
    scene = edited(small_room, more_points(4, 50))
    frame = make_frame(scene, config)
    assert len(scene.points) == len(load_scene(small_room).points) + 4
    assert frame.radius == pytest.approx(clean.radius, rel=0.05)
    assert np.ptp(scene.points, axis=0).max() > 3 * frame.radius


@pytest.mark.parametrize("distance", [1e2, 1e6, 1e11])
def test_a_camera_of_absurd_pose_is_left_out_and_named(small_room, edited, distance) -> None:
    clean = load_scene(small_room)
    stray = clean.views[5].name

    def move(model: SparseModel) -> SparseModel:
        images = tuple(
            dataclasses.replace(image, translation=(distance, 0.0, 0.0))
            if image.name == stray
            else image
            for image in model.images
        )
        return dataclasses.replace(model, images=images)

    scene = edited(small_room, move)
    assert 5 not in scene.train + scene.test and len(scene.train + scene.test) == 9
    assert f"1 of 10 cameras stand far outside and were left out: {stray}" in scene.notes
    assert clean.extent * 0.8 < scene.extent <= clean.extent * 1.2
    assert len(scene.points) == len(clean.points)


def test_points_of_a_scene_of_two_or_three_stay() -> None:
    assert not far_points(np.array([[0.0, 0, 0], [1e6, 0, 0]]), 1.0).any()
    assert not far_points(np.zeros((3, 3)), 1.0).any()
    assert far_points(np.array([[0.0, 0, 0], [1, 0, 0], [1e9, 0, 0]]), 1.0).tolist() == [0, 0, 1]


def test_cameras_in_one_place_but_one_are_all_kept() -> None:
    assert not far_cameras(np.array([[1.0, 2, 3]] * 5 + [[9.0, 9, 9]])).any()
    assert not far_cameras(np.array([[0.0, 0, 0], [1e9, 0, 0]])).any()


def test_many_points_beyond_any_parallax_are_left_out_too() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-1, 1, (1000, 3))
    points[:300] *= 1e7
    far = far_points(points, 1.0)
    assert far[:300].mean() > 0.99 and not far[300:].any()


def test_a_scene_all_of_absurd_size_is_refused(tiny, edited) -> None:
    with pytest.raises(SceneError, match=r"point 0 xyz: found \[.*1e\+300.*, expected finite"):
        edited(tiny(), lambda m: dataclasses.replace(m, points=m.points * 0 + 1e300))


@pytest.mark.parametrize("points", [1, 5])
def test_points_all_in_one_place_give_cells_of_the_cameras_size(tiny, edited, points) -> None:
    scene = edited(
        tiny(),
        lambda m: dataclasses.replace(m, points=np.ones((points, 3)), colors=m.colors[:points]),
    )
    voxel = make_frame(scene, ModelConfig()).voxel
    assert voxel == scene.extent / 1024
    assert len(initial_lattice(scene.points, voxel)) == 1
