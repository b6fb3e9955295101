"""Which photos show a point: by tracks, and where there are none by what is in front."""

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsynopsis.errors import SceneError
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.colmap.read import find_sparse, read_sparse, read_tracks
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.observations import front_most, observed


def test_a_point_behind_a_wall_of_points_is_not_front_most() -> None:
    camera = Camera(256, 256, 256.0, 256.0, 128.0, 128.0, np.eye(4))
    x, y = np.meshgrid(np.linspace(-0.9, 0.9, 60), np.linspace(-0.9, 0.9, 60))
    wall = np.stack([x.ravel(), y.ravel(), np.full(x.size, 2.0)], axis=1)
    hidden, beside, behind = [0.1, 0.1, 4.0], [0.0, 0.0, 2.1], [0.0, 0.0, -1.0]
    seen = front_most(camera, np.array([*wall, hidden, beside, behind]))
    assert seen[: len(wall)].all()
    assert seen[len(wall) :].tolist() == [False, True, False]
    assert not front_most(camera, np.array([behind])).any()


def test_tracks_name_photos_in_which_points_are(real_scene) -> None:
    scene = load_scene(real_scene("fox"))
    seen = observed(scene)
    assert len(seen) > 50_000, "tracks of 43 training photos, of 74,640 in all"
    assert set(seen.views) == set(range(len(scene.train)))
    for row in (0, len(scene.train) - 1):
        own = seen.points[seen.views == row]
        framed = scene.views[scene.train[row]].camera.framed(seen.places[own])
        assert framed.which.mean() > 0.99


def test_without_tracks_points_in_front_count(small_room) -> None:
    scene = load_scene(small_room)
    tracks, _ = read_tracks(find_sparse(small_room) or small_room)
    assert not len(tracks.images), "the procedural scene has none"
    seen = observed(scene)
    assert 0 < len(seen) < len(scene.points) * len(scene.train)
    assert seen.views.max() < len(scene.train)


CAMERAS = "1 PINHOLE 64 48 50 50 32 24\n"
IMAGES = "7 1 0 0 0 0 0 0 1 a b.png\n\n9 1 0 0 0 1 0 0 1 c.png\n\n"
POINTS = "4 0 0 5 1 2 3 0.5 7 0 9 3\n8 1 0 5 1 2 3 0.5 9 1\n"


def test_text_tracks_are_by_the_number_of_the_image(tmp_path: Path) -> None:
    for name, text in (("cameras", CAMERAS), ("images", IMAGES), ("points3D", POINTS)):
        (tmp_path / f"{name}.txt").write_text(text)
    tracks, names = read_tracks(tmp_path)
    assert tracks.images.tolist() == [7, 9, 9] and tracks.points.tolist() == [0, 0, 1]
    assert tracks.places.tolist() == [[0, 0, 5], [1, 0, 5]]
    assert names == {7: "a b.png", 9: "c.png"}


def test_binary_tracks_are_those_of_the_text(real_scene, tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    source = real_scene("brighton") / "sparse" / "0"
    pycolmap.Reconstruction(source).write_text(tmp_path)
    binary, text = read_tracks(source), read_tracks(tmp_path)
    assert binary[1] == text[1] and len(binary[0].images) > 10_000

    def pairs(tracks):
        rows = np.column_stack([tracks.places[tracks.points].round(4), tracks.images])
        return sorted(map(tuple, rows.tolist()))

    assert pairs(binary[0]) == pairs(text[0])
    assert len(read_sparse(source).images) == len(binary[1])


def test_photos_that_are_not_trained_on_are_left_out(real_scene) -> None:
    scene = load_scene(real_scene("brighton"))
    fewer = replace(scene, train=scene.train[:4])
    assert set(observed(fewer).views) <= set(range(4))


@pytest.mark.parametrize("name", ["cameras.txt", "images.txt", "cameras.bin", "images.bin"])
def test_a_file_of_three_empty_gigabytes_is_refused_before_it_is_read(tmp_path, name) -> None:
    for base, text in (("cameras", CAMERAS), ("images", IMAGES), ("points3D", POINTS)):
        (tmp_path / f"{base}.txt").write_text(text)
    if name.endswith("bin"):
        for base in ("cameras", "images"):
            (tmp_path / f"{base}.bin").write_bytes(bytes(8))
    with (tmp_path / name).open("wb") as file:
        file.truncate(3 << 30)
    tracemalloc.start()
    try:
        with pytest.raises(SceneError, match=name):
            read_sparse(tmp_path)
        assert tracemalloc.get_traced_memory()[1] < 1 << 24
    finally:
        tracemalloc.stop()
