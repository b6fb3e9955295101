"""Fresh models: the lattice that photos ask for."""

from dataclasses import replace

import numpy as np
import pytest

import gsynopsis as gs
from gsynopsis.model.build import CELL_PIXELS, FINER, photo_cell
from gsynopsis.model.lattice import KEY_LIMIT, auto_voxel, least_voxel
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene
from gsynopsis.synthetic.make_scene import make_scene


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Few points in photos of many pixels, which are not looked at."""
    folder = tmp_path_factory.mktemp("cell") / "room"
    small = load_scene(make_scene("room", folder, views=10, width=24, height=16, points=300))
    views = tuple(replace(view, camera=view.camera.resized(240, 160)) for view in small.views)
    return replace(small, views=views)


def plain_cell(scene: Scene, scale: float) -> float:
    """A pixel at the median point, point by point."""
    sizes: list[float] = []
    for view in scene.train:
        camera: Camera = scene.camera(view, scale)
        for point in scene.points:
            x, y, depth = camera.w2c[:3, :3] @ point + camera.w2c[:3, 3]
            if depth <= 0:
                continue
            u, v = camera.fx * x / depth + camera.cx, camera.fy * y / depth + camera.cy
            if 0 <= u < camera.width and 0 <= v < camera.height:
                sizes.append(depth / camera.fx)
    return CELL_PIXELS * float(np.median(sizes))


def test_a_cell_covers_so_many_pixels_at_the_median_point(scene: Scene) -> None:
    assert photo_cell(scene, 1) == pytest.approx(plain_cell(scene, 1), rel=1e-3)
    assert photo_cell(scene, 2) == pytest.approx(2 * plain_cell(scene, 1), rel=0.01)


def test_points_about_as_close_keep_their_own_distance(scene: Scene) -> None:
    points = auto_voxel(scene.points, scene.extent)
    enough = 1.01 * points / (FINER * plain_cell(scene, 1))
    assert photo_cell(scene, enough) is None and photo_cell(scene, 0.98 * enough) is not None


def test_a_scene_whose_photos_show_no_point_has_no_such_cell(scene: Scene) -> None:
    behind = replace(scene, points=scene.points + 1e6 * np.ones(3))
    assert photo_cell(behind, 1) is None


def test_a_cell_is_no_finer_than_the_lattice_can_hold(scene: Scene) -> None:
    assert 0 < least_voxel(scene.points) == np.ptp(scene.points, axis=0).max() / KEY_LIMIT
    assert photo_cell(scene, 1e-4) == least_voxel(scene.points)


def test_recipes_of_a_scene_follow_it_at_their_scale(scene: Scene) -> None:
    for scale in (1.0, 2.0):
        voxel = gs.resolve("standard", scene, {"scale": scale}).config.model.voxel
        assert voxel == photo_cell(scene, scale)
    assert gs.resolve("paper", scene).config.model.voxel == 0
