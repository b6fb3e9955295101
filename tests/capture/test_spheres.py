"""Panoramas without poses: cut into rigs of views, placed together, masks along."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsynopsis.capture.matching import first_pairs
from gsynopsis.capture.photo_set import gather, prepare, with_cuts
from gsynopsis.capture.sfm import _pairs
from gsynopsis.jobs.estimate_poses import estimate_poses
from gsynopsis.scene.load import load_scene
from gsynopsis.scene.spheres import VIEWS
from tests.scene.sphere_scenes import write_spheres
from tests.scene.test_panoramas import ordinary, wall


def spheres(root: Path, sizes: list[tuple[int, int]]) -> Path:
    for number, size in enumerate(sizes):
        wall(number, *size, around=True).save(root / f"{number}.jpg")
    return root


def test_panoramas_of_two_sizes_and_photos_become_views_of_one_size(tmp_path: Path) -> None:
    spheres(tmp_path, [(256, 128), (400, 200)])
    wall(7, 96, 64).save(tmp_path / "plain.jpg")
    gathered = gather(tmp_path)
    views = with_cuts(gathered)
    assert len(views.photos) == 2 * VIEWS + 1
    assert {p.size for p in views.photos if p.cut} == {(89, 89)}
    assert views.notes[0] == "2 panoramas are cut into 8 views each"
    prepare(views, tmp_path / "out")
    for photo in views.photos:
        with Image.open(tmp_path / "out" / photo.name) as image:
            assert image.size == photo.size


def test_masks_go_along(tmp_path: Path) -> None:
    from dataclasses import replace

    gathered = gather(spheres(tmp_path, [(256, 128)] * 3))
    mask = tmp_path / "m.png"
    found = with_cuts(replace(gathered, masks={"1.jpg": mask})).masks
    assert found == {f"view{k}/1.jpg": mask for k in range(VIEWS)}


def test_views_of_one_panorama_and_poles_with_sides_are_not_compared(tmp_path: Path) -> None:
    photos = with_cuts(gather(spheres(tmp_path, [(256, 128)] * 3))).photos
    pairs = _pairs(photos, "exhaustive")
    assert len(pairs) == 3 * (6 * 6 + 2)
    assert all(photos[a].path != photos[b].path for a, b in pairs)
    plain = tmp_path / "plain"
    plain.mkdir()
    assert _pairs(gather(ordinary(plain)).photos, "exhaustive") == first_pairs(3, "exhaustive")


@pytest.mark.slow
def test_panoramas_of_a_room_are_placed_where_they_were_taken(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    truth = write_spheres(tmp_path / "in", 4, 720)
    report = estimate_poses(tmp_path / "in", tmp_path / "scene")
    assert len(report.found.registered) == 4 * VIEWS
    assert "4 panoramas are cut into 8 views each" in report.text()
    scene = load_scene(tmp_path / "scene", "none")
    own = [
        [v.camera.position for v in scene.views if f"pano_{number:02}" in v.name]
        for number in range(4)
    ]
    assert max(np.ptp(places, axis=0).max() for places in own) < 1e-6
    a = np.array([places[0] for places in own])
    b = np.array([-w2c[:3, :3].T @ w2c[:3, 3] for w2c in truth])
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    u, s, v = np.linalg.svd(b.T @ a)
    flip = np.diag([1, 1, np.sign(np.linalg.det(u @ v))])
    scale = float((s * np.diag(flip)).sum() / np.square(a).sum())
    assert np.abs(b - scale * a @ (u @ flip @ v).T).max() < 0.02  # of a ring of 2.2 m
