"""The datasets of the papers, as they are published: folders, sizes of photos, splits.

Made-up scenes in the same layout; the files beside images and model are those that come along.
"""

import shutil
from pathlib import Path

import pytest
from PIL import Image

from gsynopsis.errors import SceneError
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.scene import Scene, SceneOptions
from gsynopsis.synthetic.make_scene import make_scene

WIDTH, HEIGHT, VIEWS = 98, 73, 34


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("datasets") / "room"
    return make_scene("room", folder, views=VIEWS, width=WIDTH, height=HEIGHT, points=80)


@pytest.fixture
def room(made: Path, tmp_path: Path) -> Path:
    return shutil.copytree(made, tmp_path / "room")


def reduce_photos(folder: Path, out: Path, size: tuple[int, int]) -> None:
    out.mkdir(exist_ok=True)
    for path in sorted(folder.iterdir()):
        with Image.open(path) as photo:
            smaller = photo.resize(size)
        smaller.save(out / path.name)


def focal_lengths(scene: Scene) -> tuple[float, float]:
    camera = scene.camera(0)
    return camera.fx, camera.fy


def sizes(scene: Scene) -> tuple[int, int]:
    camera = scene.camera(0)
    assert scene.image(0).shape == (camera.height, camera.width, 3)
    return camera.width, camera.height


@pytest.mark.parametrize("factor", [2, 4, 8])
def test_mip_nerf_360_has_its_photos_in_four_sizes(room: Path, factor: int) -> None:
    usual = load_scene(room)
    # Their copies are rounded up.
    size = -(-WIDTH // factor), -(-HEIGHT // factor)
    for number in (2, 4, 8):
        copy = -(-WIDTH // number), -(-HEIGHT // number)
        reduce_photos(room / "images", room / f"images_{number}", copy)
    (room / "poses_bounds.npy").write_bytes(b"\x93NUMPY")
    scene = load_scene(room, reading=SceneOptions(images=f"images_{factor}"))
    assert sizes(scene) == size
    fx, fy = focal_lengths(usual)
    assert focal_lengths(scene) == pytest.approx((fx * size[0] / WIDTH, fy * size[1] / HEIGHT))
    assert scene.test == usual.test == (0, 8, 16, 24, 32)


def test_tanks_and_temples_has_models_of_photos_twice_as_large(room: Path) -> None:
    usual = load_scene(room)
    reduce_photos(room / "images", room / "images", (49, 36))
    (room / "sparse" / "0" / "project.ini").write_text("log_to_stderr=false\n")
    scene = load_scene(room)
    assert sizes(scene) == (49, 36)
    fx, fy = focal_lengths(usual)
    assert focal_lengths(scene) == pytest.approx((fx * 49 / WIDTH, fy * 36 / HEIGHT))
    assert scene.test == usual.test


def test_photos_of_another_shape_than_the_model_says_are_refused(room: Path) -> None:
    reduce_photos(room / "images", room / "images", (49, 49))
    with pytest.raises(SceneError, match="49"):
        load_scene(room)


def test_deep_blending_has_photos_as_the_model_says_and_more_files(room: Path) -> None:
    usual = load_scene(room)
    for name in ("points3D.ply", "frames.txt", "rigs.bin"):
        (room / "sparse" / "0" / name).write_bytes(b"")
    (room / "database.db").write_bytes(b"SQLite format 3\0")
    scene = load_scene(room)
    assert sizes(scene) == (WIDTH, HEIGHT)
    assert scene.fingerprint() == usual.fingerprint()


def test_bungee_nerf_is_tested_on_its_first_31_photos(room: Path) -> None:
    (room / "transforms_train.json").write_text("{}")
    scene = load_scene(room, "bungee")
    assert scene.test == tuple(range(31))
    assert scene.train == (31, 32, 33)
