"""Points of photos with known poses: on the surfaces, of training photos alone."""

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree

import gsynopsis as gs
from gsynopsis.capture.triangulate import FEWEST, NEIGHBOURS, near_pairs, triangulate
from gsynopsis.errors import MissingExtraError
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.ply import ply_bytes, read_ply
from gsynopsis.scene.scene import Scene
from gsynopsis.synthetic.make_scene import make_scene

pytest.importorskip("pycolmap")
Told = list[tuple[str, int, int]]
WIDTH, HEIGHT = 240, 180


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    out = tmp_path_factory.mktemp("scenes") / "room"
    make_scene("room", out, views=20, width=WIDTH, height=HEIGHT, points=20_000)
    return load_scene(out)


@pytest.fixture(scope="module")
def found(room: Scene, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Told]:
    path, told = tmp_path_factory.mktemp("found") / "points.ply", Told()
    count = triangulate(room, path, lambda *what: told.append(what))
    assert count == len(read_ply(path)[0]) >= FEWEST
    assert [p.name for p in path.parent.iterdir()] == ["points.ply"]
    return path, told


def test_points_lie_on_the_surfaces_of_the_scene(room: Scene, found: tuple[Path, Told]) -> None:
    points, colors = read_ply(found[0])
    away, _ = cKDTree(room.points).query(points)
    assert np.median(away) < 0.02 * room.extent
    assert colors.shape == (len(points), 3) and colors.std() > 5


def test_progress_is_told_step_by_step(found: tuple[Path, Told]) -> None:
    kinds = list(dict.fromkeys(what for what, _, _ in found[1]))
    assert kinds == [
        "reading photos",
        "finding keypoints",
        "matching keypoints",
        "triangulating points",
    ]
    for kind in kinds:
        counts = [(done, of) for what, done, of in found[1] if what == kind]
        assert counts[-1][0] == counts[-1][1] and counts == sorted(counts)


def test_held_out_photos_take_no_part_and_the_points_are_the_same_again(
    room: Scene, found: tuple[Path, Told], tmp_path: Path
) -> None:
    kept = {room.views[view].path: room.views[view].path.read_bytes() for view in room.test}
    try:
        for path in kept:
            Image.new("RGB", (WIDTH, HEIGHT)).save(path)
        again = load_scene(room.root)
        triangulate(again, tmp_path / "points.ply", lambda *_: None)
    finally:
        for path, content in kept.items():
            path.write_bytes(content)
    assert (tmp_path / "points.ply").read_bytes() == found[0].read_bytes()


def test_the_file_has_the_units_of_the_scenes_files(
    room: Scene, found: tuple[Path, Told], tmp_path: Path
) -> None:
    moved = replace(room, shift=(1000.0, -20.0, 3.0))
    triangulate(moved, tmp_path / "points.ply", lambda *_: None)
    points, expected = read_ply(tmp_path / "points.ply")[0], read_ply(found[0])[0]
    assert points == pytest.approx(expected + np.array([1000, -20, 3]))


def test_blank_photos_give_no_file(room: Scene, tmp_path: Path) -> None:
    views = [replace(view, path=tmp_path / Path(view.name).name) for view in room.views]
    for view in views:
        Image.new("RGB", (WIDTH, HEIGHT), (90, 90, 90)).save(view.path)
    blank = replace(room, views=tuple(views), cache=type(room.cache)())
    assert triangulate(blank, tmp_path / "out" / "points.ply", lambda *_: None) == 0
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())


def test_pairs_are_of_neighbours_that_look_the_same_way() -> None:
    """Forty cameras on a ring that look inward: a plain search for each says the same."""
    cameras = list[Camera]()
    for turn in np.linspace(0, 2 * np.pi, 40, endpoint=False):
        rotation = np.array([[-np.sin(turn), np.cos(turn), 0], [0, 0, -1.0]])
        rotation = np.vstack([rotation, np.cross(rotation[0], rotation[1])])
        w2c = np.eye(4)
        w2c[:3, :3] = rotation
        w2c[:3, 3] = -rotation @ np.array([np.cos(turn), np.sin(turn), 0])
        cameras.append(Camera(64, 48, 60.0, 60.0, 32.0, 24.0, w2c))
    pairs = near_pairs(cameras)
    apart = {min(b - a, 40 - b + a) for a, b in pairs}
    assert pairs == sorted(set(pairs)) and all(a < b for a, b in pairs)
    assert apart <= {*range(1, 7)}  # one radian is 6.4 of 40 places
    assert {(a, a + 1) for a in range(39)} <= set(pairs)
    assert len(pairs) <= len(cameras) * len(NEIGHBOURS)


def test_points_of_a_file_are_those_written(tmp_path: Path) -> None:
    points = np.arange(12.0).reshape(4, 3) / 7
    colors = np.arange(12, dtype=np.uint8).reshape(4, 3)
    (tmp_path / "points.ply").write_bytes(ply_bytes(points, colors))
    found = read_ply(tmp_path / "points.ply")
    assert (found[0] == points).all() and (found[1] == colors).all()


@pytest.fixture
def pointless(room: Scene, tmp_path: Path) -> Path:
    """The same photos and poses, without points."""
    folder = tmp_path / "room"
    (folder / "sparse" / "0").mkdir(parents=True)
    (folder / "images").symlink_to(room.root / "images")
    for name in ("cameras.bin", "images.bin"):
        content = (room.root / "sparse" / "0" / name).read_bytes()
        (folder / "sparse" / "0" / name).write_bytes(content)
    (folder / "sparse" / "0" / "points3D.bin").write_bytes(struct.pack("<Q", 0))
    assert load_scene(folder).random_points
    return folder


def begin(folder: Path, out: Path) -> gs.Run:
    short = {"levels.steps": 3}
    return gs.train(folder, "draft", out, steps=2, settings=short, scale=4, evaluate=False)


def test_a_training_begins_with_the_points_of_its_photos_and_goes_on_with_them(
    pointless: Path, tmp_path: Path
) -> None:
    runs = [begin(pointless, tmp_path / "run") for _ in range(2)]
    (path,) = (tmp_path / "run").glob("points-*.ply")
    scene = gs.load_scene(pointless, reading=runs[0].reading)
    assert not scene.random_points and len(scene.points) == len(read_ply(path)[0])
    assert any("were found in the photos by their poses" in note for note in scene.notes)
    assert runs[0].reading == runs[1].reading and runs[0].reading.points.endswith(path.name)


def test_without_the_library_random_points_stand_in_and_it_is_said(
    pointless: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def missing(*_: object) -> int:
        raise MissingExtraError("pycolmap 4 or later", "sfm")

    monkeypatch.setattr("gsynopsis.jobs.train.triangulate", missing)
    run = begin(pointless, tmp_path / "run")
    assert run.reading.points == "" and load_scene(pointless, reading=run.reading).random_points
    told = capsys.readouterr().err
    assert "points are not looked for in the photos: pycolmap 4 or later" in told
    assert "random ones inside the cameras' bounding sphere" in told
