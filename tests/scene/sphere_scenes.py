"""Panoramas of the procedural room, as its ray caster sees them, and their poses."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmarks.train.panoramas import sphere_photo
from gsynopsis.scene.camera import look_at
from gsynopsis.synthetic.make_scene import SyntheticScene, world_and_cameras
from gsynopsis.synthetic.raytracer import RayScene


def room() -> RayScene:
    return world_and_cameras(SyntheticScene("room", 8, 64, 48, 0, 100))[0]


def poses(count: int) -> list[NDArray[np.float64]]:
    """World to camera of upright cameras that stand in a ring and look about."""
    found = list[NDArray[np.float64]]()
    for number in range(count):
        angle = 2 * np.pi * number / count
        place = np.array([2.2 * np.cos(angle), 2.2 * np.sin(angle), 1.4 + 0.2 * (number % 3)])
        ahead = place + np.array([np.cos(2 * angle + 1), np.sin(2 * angle + 1), 0.0])
        found.append(look_at(place, ahead, np.array([0.0, 0.0, 1.0])))
    return found


def write_spheres(folder: Path, count: int, width: int) -> list[NDArray[np.float64]]:
    """Panoramas in `folder/images`; their poses."""
    (folder / "images").mkdir(parents=True)
    world, found = room(), poses(count)
    for number, w2c in enumerate(found):
        picture = Image.fromarray(sphere_photo(world, w2c, width))
        picture.save(folder / "images" / f"pano_{number:02}.png")
    return found
