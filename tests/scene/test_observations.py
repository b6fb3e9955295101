"""Which photos show a point: by tracks, and where there are none by what is in front."""

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsynopsis.errors import SceneError
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.colmap.read import find_sparse, read_sparse
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
    model = read_sparse(find_sparse(small_room) or small_room)
    assert not len(model.tracks.images), "the procedural scene has none"
    seen = observed(scene)
    assert 0 < len(seen) < len(scene.points) * len(scene.train)
    assert seen.views.max() < len(scene.train)


CAMERAS = "1 PINHOLE 64 48 50 50 32 24\n"
IMAGES = "7 1 0 0 0 0 0 0 1 a b.png\n\n9 1 0 0 0 1 0 0 1 c.png\n\n"
POINTS = "4 0 0 5 1 2 3 0.5 7 0 9 3\n8 1 0 5 1 2 3 0.5 9 1\n"


def test_text_tracks_are_by_the_number_of_the_image(tmp_path: Path) -> None:
    for name, text in (("cameras", CAMERAS), ("images", IMAGES), ("points3D", POINTS)):
        (tmp_path / f"{name}.txt").write_text(text)
    model = read_sparse(tmp_path)
    assert model.tracks.images.tolist() == [7, 9, 9]
    assert model.tracks.points.tolist() == [0, 0, 1]
    assert {image.number: image.name for image in model.images} == {7: "a b.png", 9: "c.png"}


def test_binary_tracks_are_those_of_the_text(real_scene, tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    source = real_scene("brighton") / "sparse" / "0"
    pycolmap.Reconstruction(source).write_text(tmp_path)
    binary, text = read_sparse(source), read_sparse(tmp_path)
    assert len(binary.tracks.images) > 10_000

    def pairs(model):
        places = model.points[model.tracks.points].round(4)
        return sorted(map(tuple, np.column_stack([places, model.tracks.images]).tolist()))

    assert pairs(binary) == pairs(text)


@pytest.mark.parametrize(("wrong", "share"), [(0, None), (1, None), (8, "40%"), (20, "100%")])
def test_poses_that_do_not_fit_the_points_are_told(tmp_path: Path, wrong: int, share) -> None:
    sparse, photos = tmp_path / "sparse" / "0", tmp_path / "images"
    for folder in (sparse, photos):
        folder.mkdir(parents=True)
    for name in ("a b.png", "c.png"):
        Image.new("RGB", (64, 48)).save(photos / name)
    points = "".join(f"{n} 0 0 {-5 if n < wrong else 5} 1 2 3 0.5 7 0 9 {n}\n" for n in range(20))
    for name, text in (("cameras", CAMERAS), ("images", IMAGES), ("points3D", points)):
        (sparse / f"{name}.txt").write_text(text)
    notes = [note for note in load_scene(tmp_path).notes if "not of one model" in note]
    assert len(notes) == (share is not None)
    if share:
        assert notes[0].startswith(f"{share} of what sparse/0 says photos show lies outside")
        assert f"gsynopsis scene {tmp_path} {tmp_path}_scene" in notes[0]


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
