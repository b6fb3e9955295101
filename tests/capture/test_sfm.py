"""Photos of several cameras, as structure from motion is given them."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsynopsis.capture import sfm
from gsynopsis.capture.photo_set import gather, prepare
from gsynopsis.capture.sfm import FEW, find_features
from gsynopsis.scene.account import Account

pycolmap = pytest.importorskip("pycolmap", reason="pycolmap is not installed: NOT tested")
LENS, FOCAL = 0x8769, 0x920A


def save(path: Path, seed: int, size: tuple[int, int], focal: float | None = None) -> None:
    rng = np.random.default_rng(seed)
    blocks = Image.fromarray(rng.integers(0, 256, (size[1] // 8, size[0] // 8, 3)).astype(np.uint8))
    exif = Image.Exif()
    if focal is not None:
        exif.get_ifd(LENS)[FOCAL] = focal
    blocks.resize(size, Image.Resampling.NEAREST).save(path, exif=exif)


def test_photos_of_one_size_and_lens_share_a_camera_and_few_get_a_simple_one(
    tmp_path: Path,
) -> None:
    source, photos = tmp_path / "source", tmp_path / "photos"
    source.mkdir()
    for n in range(FEW):
        save(source / f"wide_{n}.jpg", n, (96, 64))
    for n in range(2):
        save(source / f"tall_{n}.jpg", 20 + n, (64, 96))
    save(source / "zoomed.jpg", 40, (96, 64), focal=50.0)
    gathered = gather(source)
    prepare(gathered, photos)
    database, told = tmp_path / "database.db", list[tuple[int, int]]()
    # Stopped after the first group and gone on with: the photos left over join its camera.
    for names in (gathered.photos[-3:], gathered.photos):
        some = type(gathered)(gathered.folder, tuple(names), Account())
        tick = lambda done, total: told.append((done, total))  # noqa: E731
        find_features(some, photos, database, "OPENCV", tick, 256)
    assert told[-1] == (len(gathered.photos),) * 2
    with pycolmap.Database.open(database) as opened:
        cameras = {camera.camera_id: camera for camera in opened.read_all_cameras()}
        of = {image.name: image.camera_id for image in opened.read_all_images()}
    assert sorted(of) == [photo.name for photo in gathered.photos]
    groups = {name.split("_")[0]: set[int]() for name in of}
    for name, camera in of.items():
        groups[name.split("_")[0]].add(camera)
    assert all(len(found) == 1 for found in groups.values()), "a camera for each group"
    assert len(cameras) == 3
    sizes = {name: cameras[min(found)] for name, found in groups.items()}
    assert (sizes["tall"].width, sizes["tall"].height) == (64, 96)
    assert sizes["tall"].model_name == sizes["zoomed.jpg"].model_name == "SIMPLE_RADIAL"


def test_a_camera_that_a_kill_left_without_its_photo_is_not_counted(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    for number in range(3):
        save(tmp_path / "photos" / f"{number}.jpg", number, (96, 64))
    gathered, database = gather(tmp_path / "photos"), tmp_path / "database.db"
    with pycolmap.Database.open(database) as opened:
        opened.write_camera(pycolmap.Camera.create_from_model_name(1, "OPENCV", 100, 96, 64))
    find_features(gathered, tmp_path / "photos", database, "OPENCV", lambda done, total: None, 256)
    with pycolmap.Database.open(database) as opened:
        assert {image.camera_id for image in opened.read_all_images()} == {1}
        assert opened.num_cameras() == 1


def test_calibration_reads_no_journal_that_a_kill_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SQLite takes such a file for the newer part of whatever lies beside under its name."""
    database, scratch = tmp_path / "database.db", tmp_path / ".global"
    pycolmap.Database.open(database).close()
    scratch.mkdir()
    for left in (tmp_path / ".global.db-wal", scratch / "database.db-wal"):
        left.write_text("older")
    beside: list[list[str]] = []

    def look(copy: Path, options: object) -> None:
        beside.append([path.name for path in copy.parent.glob(f"{copy.name}?*")])

    monkeypatch.setattr(pycolmap, "calibrate_view_graph", look)
    monkeypatch.setattr(pycolmap, "global_mapping", lambda *rest: {})
    assert sfm._map_globally(pycolmap, database, tmp_path, scratch, refined=True) == {}
    assert beside == [[]] and not scratch.exists()
