"""Sparse points of photos whose poses are known, triangulated with pycolmap.

instant-ngp, Blender and many apps write poses alone. COLMAP's triangulator finds the points by the
given poses: keypoints of the training photos, matched between photos that look the same way from
places close by. Held-out photos take no part.
"""

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gsynopsis.capture.matching import Pair
from gsynopsis.capture.sfm import CHUNK, SEED, extract_keypoints, load_pycolmap, match_pairs
from gsynopsis.files import publish, write_error
from gsynopsis.scene.camera import Camera, positions_of
from gsynopsis.scene.ply import ply_bytes
from gsynopsis.scene.scene import Scene

Told = Callable[[str, int, int], None]
"""Hears what is being done, how much of it is, and of how much."""
SIDE = 1000
"""Pixels of a photo's longer side, at most."""
FEATURES, FEATURES_MOST = 2048, 8192
"""Most keypoints of a photo: of many photos, and of few."""
KEYPOINTS = 120_000
"""Most keypoints of all photos where these are few."""
PHOTOS = 240
"""Photos at most, evenly chosen."""
NEIGHBOURS = (0, 1, 2, 3, 5, 7, 10, 14, 19, 26)
"""Places, in the order of nearness, of the photos that each is matched with: near ones share most
keypoints, farther ones tell depth best."""
WIDEST = 1.0
"""Largest angle between the directions in which both look, radians."""
TURN = 2.0
"""Weight of that angle, in radians, beside the distance of both in spreads of all cameras."""
LARGEST_ERROR = 2.0
"""Largest mean error of a point, pixels."""
FEWEST = 300
"""Points below which random ones are the better beginning."""


def triangulate(scene: Scene, path: Path, told: Told) -> int:
    """Find points seen by several training photos and write them, a PLY in the files' units.

    Args:
        scene: Its points do not count.
        path: The file; nothing is written where fewer than `FEWEST` are found.
        told: Hears of progress.

    Returns:
        How many were found.

    Raises:
        MissingExtraError: pycolmap is not installed.
        SceneError: a photo cannot be decoded.
        SpaceError: the disk is full.
    """
    load_pycolmap()
    work = path.with_name(f".{path.stem}.work")
    shutil.rmtree(work, ignore_errors=True)
    try:
        points, colors = _found(scene, work, told)
    except OSError as error:
        raise write_error(path, error) from error
    finally:
        shutil.rmtree(work, ignore_errors=True)
    if len(points) >= FEWEST:
        publish(path, ply_bytes(points + np.array(scene.shift), colors))
    return len(points)


def near_pairs(cameras: Sequence[Camera]) -> list[Pair]:
    """Pairs of photos that see the same from places close by, ascending."""
    places = positions_of(cameras)
    looks = np.stack([camera.forward for camera in cameras])
    away = np.linalg.norm(places - np.median(places, axis=0), axis=1)
    spread = float(np.median(away)) or 1.0
    found = set[Pair]()
    for index in range(len(cameras)):
        angles = np.arccos(np.clip(looks @ looks[index], -1, 1))
        distances = np.linalg.norm(places - places[index], axis=1) / spread
        order = np.argsort(distances + TURN * angles, kind="stable")
        others = [int(other) for other in order if other != index and angles[other] <= WIDEST]
        found |= {
            (min(index, others[place]), max(index, others[place]))
            for place in NEIGHBOURS
            if place < len(others)
        }
    return sorted(found)


def _found(scene: Scene, work: Path, told: Told) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Points [P, 3] and their colours, uint8 [P, 3]."""
    photos, database = work / "photos", work / "database.db"
    photos.mkdir(parents=True)
    stride = -(-len(scene.train) // PHOTOS)
    names, cameras = list[str](), list[Camera]()
    chosen = scene.train[::stride]
    for done, view in enumerate(chosen, 1):
        camera = scene.views[view].camera
        factor = max(1.0, max(camera.width, camera.height) / SIDE)
        names.append(f"{view:06d}.png")
        cameras.append(scene.camera(view, factor))
        Image.fromarray(scene.image(view, factor)).save(photos / names[-1], compress_level=1)
        told("reading photos", done, len(chosen))
    features = min(FEATURES_MOST, max(FEATURES, KEYPOINTS // len(names)))
    _find_keypoints(photos, database, names, features, told)
    pairs = near_pairs(cameras)
    match_pairs(database, names, pairs, lambda done, of: told("matching keypoints", done, of))
    told("triangulating points", 0, 1)
    model = _triangulated(work, photos, database, dict(zip(names, cameras, strict=True)))
    told("triangulating points", 1, 1)
    good = [p for p in model.points3D.values() if p.error <= LARGEST_ERROR]
    points = np.array([p.xyz for p in good], np.float32).reshape(-1, 3)
    return points.astype(np.float64), np.array([p.color for p in good], np.uint8).reshape(-1, 3)


def _find_keypoints(
    photos: Path, database: Path, names: Sequence[str], features: int, told: Told
) -> None:
    """SIFT keypoints of every photo, at most so many; each has a camera of its own."""
    colmap = load_pycolmap()
    mode, reader = colmap.CameraMode.PER_IMAGE, colmap.ImageReaderOptions()
    reader.camera_model = "PINHOLE"
    for start in range(0, len(names), CHUNK):
        some = names[start : start + CHUNK]
        extract_keypoints(photos, database, some, features, mode, reader)
        told("finding keypoints", min(start + CHUNK, len(names)), len(names))


def _triangulated(work: Path, photos: Path, database: Path, cameras: dict[str, Camera]) -> Any:
    """COLMAP's model of the matched keypoints by the given cameras, by name."""
    colmap = load_pycolmap()
    with colmap.Database.open(database) as opened:
        numbers = {
            image.name: (image.image_id, image.camera_id) for image in opened.read_all_images()
        }
    lenses, poses = list[str](), list[str]()
    for name, camera in cameras.items():
        image, lens = numbers[name]
        size = f"{camera.width} {camera.height}"
        focal = f"{camera.fx!r} {camera.fy!r} {camera.cx!r} {camera.cy!r}"
        lenses.append(f"{lens} PINHOLE {size} {focal}\n")
        x, y, z, w = colmap.Rotation3d(camera.w2c[:3, :3]).quat
        place = " ".join(repr(float(value)) for value in (w, x, y, z, *camera.w2c[:3, 3]))
        poses.append(f"{image} {place} {lens} {name}\n\n")
    known, found = work / "known", work / "found"
    known.mkdir()
    found.mkdir()
    (known / "cameras.txt").write_text("".join(lenses), "utf-8")
    (known / "images.txt").write_text("".join(poses), "utf-8")
    (known / "points3D.txt").write_text("", "utf-8")
    options = colmap.IncrementalPipelineOptions()
    # The solver's last bits vary: fewer with one thread, and none once they are rounded.
    options.num_threads, options.random_seed = 1, SEED
    return colmap.triangulate_points(
        colmap.Reconstruction(known), database, photos, found, options=options
    )
