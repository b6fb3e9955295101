"""Up of Gaussians of which no file says it: gravity as surfaces and their heights show it (ours).

Floors, tables and ground lie across it, walls and trunks stand along it, and things stand on the
ground, not below it. Programs have customs, z up or y down, which decide where that is not clear.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from gsynopsis.cameras.placement import Subject
from gsynopsis.cameras.view_dependence import on_sphere, photo_direction
from gsynopsis.capture.upright import up_of
from gsynopsis.formats.axes import Up, matrix_of
from gsynopsis.records import PlainGaussians
from gsynopsis.scene.camera import Camera, unit

Float64 = NDArray[np.float64]
LYING, STANDING = np.radians(8.0), np.radians(8.0)
"""Largest angles of normals to the axis, and to being at right angles to it, radians."""
FACES, NEIGHBOURS, TILTED = 6000, 24, np.radians(20.0)
"""Planes that are laid through points, each through so many neighbours, and how far they may be
from lying, radians."""
PLANE, STEADY, PARALLEL = 0.05, 4.0, 0.9
"""Least mean square of the rows of pictures along the second of their directions, and times that
along the last, with which they lie in a plane; and length of the mean of views that all go one way.
"""
PEAKS = 8
"""Most frequent directions of surfaces that are tried."""
APART = np.radians(15.0)
"""Between them, radians."""
DIRECTIONS = 1500
"""On half a sphere, at which peaks are looked for."""
SLAB = 0.03
"""Share of the range of heights that counts as one level, as a floor is."""
GROUND = 0.15
"""Share of surfaces across an axis from which on the level of most of them is taken for ground."""
Z_UP, Y_UP, BACK = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)
AROUND, ABOVE = (0.05, 0.36), 0.15
"""Lengths of the mean direction to photos that were taken from many sides, so that little but their
height above things is left of it; and what it counts then to be the way up."""
STEEPLY, BELOW, MOST_BELOW = 0.4, 3.0, 0.4
"""Sine from which on photos look steeply up, as hardly any do, and what it counts per length, and
at most."""
OPPOSITE = 0.15
"""By how much the opposite of the custom is less likely, where photos look up by the custom."""
EVIDENCE = 0.1
"""Share of surfaces across an axis beyond those of chance, weighed as in the score, from which on
these speak for it against the custom."""
CLOSE, MOST = 0.35, 4
"""By how much a guess may be worse than the best, and how many others than the custom there are."""


class Guess(NamedTuple):
    """A direction that may be up [3], its score, and shares of photos and of surfaces across it."""

    up: Float64
    score: float
    photos: float
    across: float


def guesses(gaussians: PlainGaussians, subject: Subject, custom: Up) -> list[Guess]:
    """Directions that may be up, the custom first, then others that are as good, best first.

    Args:
        gaussians: The scene, or fewer splats that cover it.
        subject: What it is about, of any up.
        custom: Up by the custom of the file's format.
    """
    surfaces, usual = _surfaces(gaussians, subject), np.array(custom, float)
    photos = photo_direction(subject.harmonics)

    def guessed(up: Float64, custom: Float64 = usual) -> Guess:
        from_above, across = _photographed(up, photos), _across(surfaces, up)
        score = _score(surfaces, up, across, custom) + from_above
        return Guess(up, score, from_above, across)

    axes = [*_snapped(usual), *_peaks(surfaces)]
    found = [guessed(up) for axis in axes for up in (axis, -axis)]
    # A round thing has walls and tops about any axis, a little more about some: no reason to turn.
    found = [each for each in found if each.photos > 0 or each.across > EVIDENCE]
    if usual @ photos < 0:
        # Some programs write COLMAP's worlds as they are into formats whose custom is another.
        opposite = guessed(-usual, -usual)
        found.append(opposite._replace(score=opposite.score - OPPOSITE))
    out = [guessed(usual)]
    least = max(guess.score for guess in (*out, *found)) - CLOSE
    for guess in sorted(found, key=lambda each: -each.score):
        new = all(guess.up @ other.up < np.cos(APART) for other in out[1:])
        if new and guess.score > least:
            out.append(guess)
    return out[: 1 + MOST]


def up_of_cameras(cameras: Sequence[Camera]) -> Float64:
    """Up by cameras that people hold level, unit length [3].

    It is most at right angles to all rows of the pictures. Where these have one direction only, as
    in a straight flight, it is the mean of the pictures' own, or their way back (`scene.upright`).
    """
    rights = np.stack([camera.w2c[0, :3] for camera in cameras])
    values, axes = np.linalg.eigh(rights.T @ rights / len(cameras))
    ups = -np.stack([camera.w2c[1, :3] for camera in cameras]).mean(axis=0)
    # Looking down, a mean of ups leans to the side from which most photos are.
    if values[1] > PLANE and values[1] > STEADY * values[0]:
        return axes[:, 0] * (1.0 if axes[:, 0] @ ups >= 0 else -1.0)
    back = -np.stack([camera.forward for camera in cameras]).mean(axis=0)
    if values[1] <= PLANE and np.linalg.norm(back) > PARALLEL:
        return unit(back)
    return up_of(cameras)


@dataclass(frozen=True)
class _Surfaces:
    """Flat splats of a subject.

    Attributes:
        points: Places [S, 3].
        normals: Of them, of either sign [S, 3].
        weights: By what they show, of sum 1 [S].
        faces: Normals of planes through neighbouring points, where these lie in one [F, 3].
        flat: How well they do, of sum 1 [F].
    """

    points: Float64
    normals: Float64
    weights: Float64
    faces: Float64
    flat: Float64


def _surfaces(g: PlainGaussians, subject: Subject) -> _Surfaces:
    away = np.linalg.norm(g.means.astype(np.float64) - subject.middle, axis=1)
    opacity = 1 / (1 + np.exp(-g.logits.astype(np.float64)))
    near = (away <= 1.5 * subject.radius) & (opacity >= subject.opacity)
    scales = g.log_scales[near].astype(np.float64)
    order = np.sort(scales, axis=1)
    flat = np.clip(order[:, 1] - order[:, 0] - np.log(2), 0, 1)
    area = np.exp(order[:, 1] + order[:, 2])
    area = np.minimum(area, np.quantile(area, 0.9)) if len(area) else area
    weights = flat * opacity[near] * np.sqrt(area)
    normals = _axis(g.quaternions[near].astype(np.float64), scales.argmin(axis=1))
    total = float(weights.sum())
    if total <= 0:
        none = np.zeros((0, 3))
        return _Surfaces(none, none, np.zeros(0), none, np.zeros(0))
    points, weights = g.means[near].astype(np.float64), weights / total
    return _Surfaces(points, normals, weights, *_faces(subject.points))


def _faces(points: Float64) -> tuple[Float64, Float64]:
    """Normals of planes through neighbouring points [F, 3], and how flat these lie [F].

    Splats of grass and leaves face anywhere; a lawn of them is a plane all the same.
    """
    if len(points) < 2 * NEIGHBOURS:
        return np.zeros((0, 3)), np.zeros(0)
    _, near = KDTree(points).query(points[:: -(-len(points) // FACES)], k=NEIGHBOURS)
    away = points[near] - points[near].mean(axis=1, keepdims=True)
    values, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", away, away))
    flat = 1 - values[:, 0] / np.maximum(values[:, 1], 1e-300)
    return axes[:, :, 0], flat / max(float(flat.sum()), 1e-300)


def _axis(quaternions: Float64, which: NDArray[np.int64]) -> Float64:
    """A column of each rotation: the direction of one of a splat's axes [S, 3]."""
    q = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    matrices = matrix_of(q.T)  # [3, 3, S]
    return matrices[:, which, np.arange(len(q))].T


def _peaks(surfaces: _Surfaces) -> list[Float64]:
    """Directions in which many surfaces face, most of them first."""
    if not len(surfaces.weights):
        return []
    grid = on_sphere(2 * DIRECTIONS)[:DIRECTIONS]
    chance = np.random.default_rng(0)
    rows = chance.choice(len(surfaces.weights), 8000, p=surfaces.weights)
    normals = surfaces.normals[rows]
    density = (np.abs(grid @ normals.T) > np.cos(LYING)).sum(axis=1)
    out: list[Float64] = []
    for row in np.argsort(-density):
        axis = _refined(grid[row], normals)
        if all(abs(axis @ other) < np.cos(APART) for other in out):
            out.append(axis)
        if len(out) == PEAKS:
            break
    # Planes through points find a lawn that splats do not, but less exactly than splats of a floor.
    main = np.linalg.eigh((surfaces.faces * surfaces.flat[:, None]).T @ surfaces.faces)[1][:, -1]
    return [*out, _refined(main, surfaces.faces)]


def _refined(axis: Float64, normals: Float64) -> Float64:
    """The direction that normals near an axis have most in common."""
    for angle in (LYING, LYING, LYING / 2, LYING / 2):
        near = normals[np.abs(normals @ axis) > np.cos(angle)]
        if len(near) < 8:
            return axis
        mean = np.linalg.eigh(near.T @ near)[1][:, -1]
        axis = mean * np.sign(mean @ axis)
    return axis


def _snapped(usual: Float64) -> list[Float64]:
    """Axes that programs have up along."""
    named = [np.array(axis) for axis in (Z_UP, Y_UP)]
    return [axis for axis in named if abs(axis @ usual) < 1 - 1e-9]


def _score(surfaces: _Surfaces, up: Float64, across: float, custom: Float64) -> float:
    """Score of a direction as up: by surfaces, by what stands on them, and by customs."""
    custom_score = _custom(up, custom)
    if not len(surfaces.weights):
        return custom_score
    w, slope = surfaces.weights, np.abs(surfaces.normals @ up)
    lying = slope > np.cos(LYING)
    # Of normals of all directions so many would be at right angles to it.
    standing = float(w[slope < np.sin(STANDING)].sum()) - np.sin(STANDING)
    ground = min(1.0, float(w[lying].sum()) / GROUND) * _standing_on(surfaces, up, lying)
    return across + 0.7 * standing + 0.25 * ground + custom_score


def _across(surfaces: _Surfaces, up: Float64) -> float:
    """Shares of splats and of planes that lie across a direction, beyond those of chance."""
    lying = float(surfaces.weights[np.abs(surfaces.normals @ up) > np.cos(LYING)].sum())
    faces = float(surfaces.flat[np.abs(surfaces.faces @ up) > np.cos(TILTED)].sum())
    return 1.5 * (lying - (1 - np.cos(LYING))) + faces - (1 - np.cos(TILTED))


def _standing_on(surfaces: _Surfaces, up: Float64, lying: NDArray[np.bool_]) -> float:
    """Share of what lies above the most frequent level, less that below; -1 to 1."""
    heights, w = surfaces.points @ up, surfaces.weights
    if lying.sum() < 8:
        return 0.0
    low, high = np.quantile(heights, [0.01, 0.99])
    slab = max(float(high - low), 1e-12) * SLAB
    counts, edges = np.histogram(
        heights[lying], np.arange(low, high + 2 * slab, slab), weights=w[lying]
    )
    level = edges[int(counts.argmax())] + slab / 2
    above, below = float(w[heights > level + slab].sum()), float(w[heights < level - slab].sum())
    return (above - below) / max(above + below, 1e-12)


def _photographed(up: Float64, photos: Float64) -> float:
    """Score of a direction as up by the mean direction to where photos were taken [3]."""
    length, high = float(np.linalg.norm(photos)), float(up @ photos)
    score = -min(MOST_BELOW, BELOW * max(0.0, -high - STEEPLY * length))
    if AROUND[0] <= length <= AROUND[1]:
        score += ABOVE * high / length
    return score


def _custom(up: Float64, custom: Up | Float64) -> float:
    """Prior of a direction: a wall may face anywhere, but up is where programs put it.

    That is, about the custom of the format; exactly along another axis that is up by custom; or,
    of photos straight down in the world of the first, about that photo's way back.
    """
    places = ((custom, 0.65, 30.0), (Z_UP, 0.6, 3.0), (Y_UP, 0.5, 3.0), (BACK, 0.45, 12.0))
    cosines = [float(np.clip(up @ np.array(axis), -1, 1)) for axis, _, _ in places]
    offs = np.degrees(np.arccos(cosines))
    scores = [
        most * float(np.exp(-0.5 * (off / within) ** 2))
        for off, (_, most, within) in zip(offs, places, strict=True)
    ]
    return max(scores)
