"""Panoramas are cut into views that see what perspective cameras at the same place see."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from benchmarks.train.panoramas import sphere_photo
from gsynopsis.errors import SceneError
from gsynopsis.evaluation.metrics import psnr
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.colmap.model import quaternion_from_rotation
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.masks import load_mask
from gsynopsis.scene.photo_files import PhotoStore
from gsynopsis.scene.scene import Scene
from gsynopsis.scene.spheres import ANGLE, VIEWS, cut_view, cuts_of
from gsynopsis.synthetic.raytracer import render
from tests.scene.sphere_scenes import poses, room

SIZE = (400, 200)


def directions(size: tuple[int, int]) -> NDArray[np.float64]:
    """Of each pixel of a panorama [H, W, 3]."""
    width, height = size
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    lon, lat = (u - 0.5) * 2 * np.pi, (v - 0.5) * np.pi
    parts = [np.cos(lat) * np.sin(lon), np.sin(lat), np.cos(lat) * np.cos(lon)]
    return np.stack(parts, axis=-1)


def painted(size: tuple[int, int] = SIZE) -> NDArray[np.uint8]:
    """A panorama whose colour is the direction."""
    return np.rint((directions(size) / 2 + 0.5) * 255).astype(np.uint8)


@pytest.mark.parametrize("number", range(VIEWS))
def test_each_view_shows_its_directions_across_seam_and_poles(number: int) -> None:
    cut = cuts_of(SIZE)[number]
    width, height, fx, fy, cx, cy = cut.pinhole
    x, y = np.meshgrid((np.arange(width) + 0.5 - cx) / fx, (np.arange(height) + 0.5 - cy) / fy)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    world = rays / np.linalg.norm(rays, axis=-1, keepdims=True) @ cut.rotation
    assert np.abs(cut_view(painted(), cut) - (world / 2 + 0.5) * 255).max() < 1.5
    assert np.linalg.det(cut.rotation) == pytest.approx(1)


def test_no_direction_is_left_out() -> None:
    rays, seen = directions(SIZE).reshape(-1, 3), np.zeros(SIZE[0] * SIZE[1], np.int64)
    for cut in cuts_of(SIZE):
        x, y, z = (rays @ cut.rotation.T).T
        most = np.tan(ANGLE / 2)
        seen += (z > 0) & (np.abs(x) <= most * z) & (np.abs(y) <= most * z)
    assert seen.min() >= 1


def test_views_are_those_of_perspective_cameras_at_the_same_place() -> None:
    world, pose = room(), poses(5)[1]
    panorama = sphere_photo(world, pose, 512)
    for cut in cuts_of((512, 256))[::3]:
        turned = pose.copy()
        turned[:3] = cut.rotation @ pose[:3]
        direct = render(world, Camera(*cut.pinhole, turned))
        assert psnr(cut_view(panorama, cut), direct) > 28


def check_views(scene: Scene, w2cs: list[NDArray[np.float64]], names: list[str]) -> None:
    assert len(scene.views) == VIEWS * len(names)
    found = {view.name: view.camera for view in scene.views}
    for name, w2c in zip(names, w2cs, strict=True):
        for number, cut in enumerate(cuts_of(SIZE)):
            camera = found[f"view{number}/{name}"]
            assert np.allclose(camera.w2c[:3], cut.rotation @ w2c[:3], atol=1e-9)
            assert (camera.width, camera.fx) == (cut.pinhole[0], cut.pinhole[2])
    assert any("3 panoramas are cut into 8 views each" in note for note in scene.notes)
    index = next(i for i, v in enumerate(scene.views) if v.name == f"view2/{names[0]}")
    assert np.array_equal(scene.image(index), cut_view(painted(), cuts_of(SIZE)[2]))


def photos(folder: Path, count: int = 3) -> list[str]:
    folder.mkdir(parents=True)
    for number in range(count):
        Image.fromarray(painted()).save(folder / f"{number}.png")
    return [f"{number}.png" for number in range(count)]


@pytest.mark.parametrize("model", ["EQUIRECTANGULAR", "equirectangular", "SPHERICAL"])
def test_a_transforms_json_of_panoramas_is_read(model: str, tmp_path: Path) -> None:
    names, w2cs = photos(tmp_path / "images"), poses(3)
    opengl = np.diag([1.0, -1.0, -1.0, 1.0])
    frames = [
        {
            "file_path": f"images/{name}",
            "transform_matrix": (np.linalg.inv(w2c) @ opengl).tolist(),
            "mask_path": "object.png",
        }
        for name, w2c in zip(names, w2cs, strict=True)
    ]
    mask = np.zeros((200, 400), np.uint8)
    mask[:, :200] = 255
    Image.fromarray(mask).save(tmp_path / "object.png")
    top = {"camera_model": model, "w": 400, "h": 200, "test_filenames": ["images/1.png"]}
    (tmp_path / "transforms.json").write_text(json.dumps({**top, "frames": frames}))
    scene = load_scene(tmp_path)
    check_views(scene, w2cs, [f"images/{name}" for name in names])
    assert {scene.views[i].name for i in scene.test} == {f"view{k}/images/1.png" for k in range(8)}
    front = next(view for view in scene.views if view.name.startswith("view0"))
    shown = load_mask(front, 1)
    assert shown is not None
    assert shown[:, : shown.shape[1] // 2 - 1].min() == 1 and shown[:, -20:].max() == 0


def colmap_scene(root: Path, size: tuple[int, int] = SIZE) -> list[NDArray[np.float64]]:
    names, w2cs = photos(root / "images"), poses(3)
    folder = root / "sparse" / "0"
    folder.mkdir(parents=True)
    wide, high = size
    (folder / "cameras.txt").write_text(f"1 EQUIRECTANGULAR {wide} {high} {wide} {high}\n")
    lines = [
        f"{n + 1} {' '.join(map(repr, quaternion_from_rotation(w2c[:3, :3])))} "
        f"{' '.join(map(str, w2c[:3, 3].tolist()))} 1 {name}\n\n"
        for n, (name, w2c) in enumerate(zip(names, w2cs, strict=True))
    ]
    (folder / "images.txt").write_text("".join(lines))
    (folder / "points3D.txt").write_text("1 0 0 1 9 9 9 0\n2 0.5 0 1 9 9 9 0\n")
    return w2cs


def test_a_model_of_panoramas_is_read(tmp_path: Path) -> None:
    w2cs = colmap_scene(tmp_path, (800, 400))  # photos are smaller copies
    check_views(load_scene(tmp_path), w2cs, ["0.png", "1.png", "2.png"])


def test_what_colmap_writes_is_the_same(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    w2cs = colmap_scene(tmp_path)
    folder = tmp_path / "sparse" / "0"
    model = pycolmap.Reconstruction(folder)
    ray = model.cameras[1].cam_ray_from_img([[301.0, 53.0]])[0]
    assert np.allclose(ray, directions(SIZE)[52:54, 300:302].mean(axis=(0, 1)), atol=1e-3)
    for path in folder.iterdir():
        path.unlink()
    model.write_binary(folder)
    check_views(load_scene(tmp_path), w2cs, ["0.png", "1.png", "2.png"])


def test_masks_of_a_folder_go_with_their_panorama(tmp_path: Path) -> None:
    colmap_scene(tmp_path)
    (tmp_path / "masks").mkdir()
    for number in range(3):
        Image.new("L", SIZE, 255 if number else 128).save(tmp_path / "masks" / f"{number}.png")
    scene = load_scene(tmp_path)
    assert all(view.mask is not None for view in scene.views)
    assert "24 of 24 photos" in scene.account.masks


def test_a_store_keeps_the_views(tmp_path: Path) -> None:
    colmap_scene(tmp_path)
    scene, store = load_scene(tmp_path), PhotoStore(tmp_path / "kept")
    direct = [scene.image(view, 2) for view in range(3)]
    scene.cache.store = store
    assert all(np.array_equal(scene.image(view, 2), direct[view]) for view in range(3))


def test_a_part_of_a_sphere_is_refused(tmp_path: Path) -> None:
    colmap_scene(tmp_path)
    for path in (tmp_path / "images").iterdir():
        Image.new("RGB", (400, 150)).save(path)
    (tmp_path / "sparse" / "0" / "cameras.txt").write_text("1 EQUIRECTANGULAR 400 150 400 150\n")
    with pytest.raises(SceneError, match=r"panorama: found 400x150, expected the whole sphere"):
        load_scene(tmp_path)
