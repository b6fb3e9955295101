"""Scenes in coordinates of a map are moved to their origin, and only these."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsynopsis.scene.colmap.binary import write_binary
from gsynopsis.scene.colmap.model import SparseModel, rotation_from_quaternion
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.observations import observed
from tests.scene.tiny_models import SIZE, tiny_model

UTM = np.array([500_000.0, 5_400_000.0, 300.0])
NAMES = ("a.png", "b.png", "c.png")


def far_model(by: np.ndarray) -> SparseModel:
    """The tiny model elsewhere."""
    model = tiny_model(NAMES)
    images = []
    for image in model.images:
        place = np.array(image.translation) - rotation_from_quaternion(image.quaternion) @ by
        images.append(replace(image, translation=tuple(place.tolist())))
    return replace(model, images=tuple(images), points=model.points + by)


def test_a_scene_of_a_map_is_the_same_scene_moved(tiny) -> None:
    root = tiny(NAMES)
    usual = load_scene(root)
    assert usual.shift == (0, 0, 0)
    shutil.rmtree(root / "sparse")
    write_binary(root / "sparse" / "0", far_model(UTM))
    scene = load_scene(root)
    assert np.abs(np.array(scene.shift) - UTM).max() < 10
    assert any("moved by minus (" in note for note in scene.notes)
    moved = UTM - scene.shift
    for own, view in zip(scene.views, usual.views, strict=True):
        assert np.allclose(own.camera.position, view.camera.position + moved, atol=1e-6)
        assert np.array_equal(own.camera.w2c[:3, :3], view.camera.w2c[:3, :3])
    assert np.allclose(scene.points, usual.points + moved, atol=1e-6)


@pytest.mark.parametrize("by", [(0, 0, 0), (1, -0.5, 0.2), (10, 0, 0)])
def test_a_scene_near_enough_stays(by: tuple[float, float, float], tiny) -> None:
    root = tiny(NAMES)
    shutil.rmtree(root / "sparse")
    write_binary(root / "sparse" / "0", far_model(np.array(by, np.float64)))
    assert load_scene(root).shift == (0, 0, 0)


def test_poses_of_realitycapture_on_a_map_are_moved(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    lines = ["#name,x,y,alt,heading,pitch,roll,f"]
    for number in range(4):
        Image.new("RGB", SIZE, (9, 9, 9)).save(tmp_path / "images" / f"{number}.png")
        lines.append(f"{number}.png,{UTM[0] + number},{UTM[1] + number % 2},80,10,60,3,30")
    (tmp_path / "cameras.csv").write_text("\n".join(lines))
    scene = load_scene(tmp_path)
    assert np.abs(np.array(scene.shift) - (UTM[0], UTM[1], 80)).max() <= 2
    assert scene.account.source == "cameras.csv"
    assert np.abs([view.camera.position for view in scene.views]).max() < 5


def test_tracks_are_moved_along(tiny) -> None:
    root = tiny(NAMES)
    shutil.rmtree(root / "sparse")
    write_binary(root / "sparse" / "0", far_model(UTM))
    assert np.abs(observed(load_scene(root)).places).max() < 100
