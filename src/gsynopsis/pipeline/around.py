"""Cameras for Gaussians of which nobody says from where they were photographed (ours).

Where surfaces are on all sides of free places, as in a room or in a capture that looks outwards
too, cameras stand in free places and look at surfaces. Else they stand around what there is.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from gsynopsis.pipeline.orbit import default_lens, look_at
from gsynopsis.records import PlainGaussians
from gsynopsis.scene.camera import Camera

SAMPLE = 4096
"""Gaussians that stand for all, drawn by how much they show."""
PLACES = 256
"""Places that are tried for a camera."""
SURROUNDED = 0.7
"""Share of directions with something in them from which on a place is inside."""
CELLS = 3
"""Directions are told apart by a cube's faces of so many cells each way."""
FREE_SHARE = 0.15
"""Of the scene's radius, that a free place is away from what is there, at least."""
DISTANCES = (1.3, 2.2)
"""Radii of the scene between which cameras around it stand."""
ELEVATIONS = (-0.1, 0.7)
"""Of those cameras, radians."""

Float64 = NDArray[np.float64]


def shown(gaussians: PlainGaussians) -> Float64:
    """About how much of a picture each Gaussian fills: opacity times the area of its face [G]."""
    scales = np.sort(gaussians.log_scales.astype(np.float64), axis=1)
    opacity = 1 / (1 + np.exp(-gaussians.logits.astype(np.float64)))
    return opacity * np.exp(scales[:, 1] + scales[:, 2])


def cameras_around(
    gaussians: PlainGaussians, up: tuple[float, float, float], count: int, width: int, seed: int
) -> list[Camera]:
    """Cameras that see a scene as a visitor would.

    Args:
        gaussians: The scene.
        up: Away from the ground, unit length.
        count: How many.
        width: Of pictures, pixels.
        seed: Other seeds give other cameras of the same kind.
    """
    chance = np.random.default_rng(seed)
    points = sampled(gaussians, chance)
    middle = np.median(points, axis=0)
    radius = max(float(np.quantile(np.linalg.norm(points - middle, axis=1), 0.8)), 1e-9)
    lens = default_lens().scaled(default_lens().width / width)
    inside = free_places(points, middle, radius, chance)
    axis = np.array(up)
    cameras: list[Camera] = []
    for number in range(count):
        if len(inside):
            eye = inside[number % len(inside)]
            far = points[np.linalg.norm(points - eye, axis=1) > FREE_SHARE * radius]
            target = far[chance.integers(len(far))] if len(far) else middle
        else:
            eye = middle + radius * _place(axis, number / count, chance)
            target = middle + 0.15 * radius * chance.standard_normal(3)
        w2c = look_at(eye, target, axis)
        cameras.append(Camera(lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy, w2c))
    return cameras


def sampled(gaussians: PlainGaussians, chance: np.random.Generator) -> Float64:
    """Positions of some Gaussians, drawn by how much they show [SAMPLE, 3]."""
    weight = np.minimum(shown(gaussians), np.quantile(shown(gaussians), 0.999))
    total = float(weight.sum())
    share = weight / total if total > 0 else None
    rows = chance.choice(len(gaussians), min(SAMPLE, 4 * len(gaussians)), p=share)
    return gaussians.means[rows].astype(np.float64)


def free_places(
    points: Float64, middle: Float64, radius: float, chance: np.random.Generator
) -> Float64:
    """Places near the middle with room around them and surfaces on most sides [P, 3]."""
    low, high = np.quantile(points, 0.15, axis=0), np.quantile(points, 0.85, axis=0)
    places = low + chance.random((PLACES, 3)) * (high - low)
    clear = np.asarray(KDTree(points).query(places, k=8)[0])[:, -1]
    places = places[clear > FREE_SHARE * radius]
    covered = np.array([_covered(points - place) for place in places])
    return places[covered >= SURROUNDED] if len(places) else places


def _covered(away: Float64) -> float:
    """Share of directions in which there is something."""
    axis = np.abs(away).argmax(axis=1)
    rows = np.arange(len(away))
    main = away[rows, axis]
    others = np.stack([away[rows, (axis + 1) % 3], away[rows, (axis + 2) % 3]], axis=1)
    cell = np.floor((others / np.abs(main)[:, None].clip(1e-12) + 1) / 2 * CELLS)
    cell = np.clip(cell, 0, CELLS - 1).astype(np.int64)
    face = 2 * axis + (main > 0)
    found = np.unique((face * CELLS + cell[:, 0]) * CELLS + cell[:, 1])
    return len(found) / (6 * CELLS * CELLS)


def _place(up: Float64, turn: float, chance: np.random.Generator) -> Float64:
    """A place around the origin, in radii of the scene."""
    side = np.cross(up, [1.0, 0.0, 0.0] if abs(up[0]) < 0.9 else [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    angle = 2 * np.pi * (turn + chance.random() / 16)
    flat = np.cos(angle) * side + np.sin(angle) * np.cross(up, side)
    tilt = ELEVATIONS[0] + chance.random() * (ELEVATIONS[1] - ELEVATIONS[0])
    distance = DISTANCES[0] + chance.random() * (DISTANCES[1] - DISTANCES[0])
    return distance * (np.cos(tilt) * flat + np.sin(tilt) * up)
