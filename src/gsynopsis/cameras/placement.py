"""Places for cameras of Gaussians of which nobody says from where they were photographed (ours).

Cameras stand around what there is and see all of it, or in free places among it and look at
surfaces. `screening` says which of the two is right, and which cameras see something.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree
from torch import Tensor

from gsynopsis.cameras.orbit import default_lens, look_at
from gsynopsis.records import PlainGaussians
from gsynopsis.scene.camera import Camera

SAMPLE = 16384
"""Gaussians that stand for all, drawn by number: detail is where there are many."""
OPACITY = 0.1
"""Fainter ones do not count, unless almost all are faint."""
SIGMAS = 2.0
"""Standard deviations of a Gaussian that have to be in a picture."""
NEIGHBOURS = 8
"""Next Gaussian but so many that tells how dense it is there: at least, and of each hundred one."""
SPARSE = 8.0
"""Times the distance to it in dense parts, from which on a Gaussian may lie alone."""
GAP, FAR = 3.0, 4.0
"""It does, if that is so many times its own size, or so many radii of the dense parts away."""
WHOLE = 0.99
"""Share of what there is that a camera around it has in its picture."""
WHOLLY, NEARER = (1.05, 1.15), (0.6, 1.1)
"""Times the distance for that at which such cameras stand; and those that see parts as well."""
ELEVATIONS = (0.05, 0.7)
"""Elevation of those cameras, radians."""
FLAT, STEEPER = 0.3, 0.35
"""Height by width below which cameras stand higher, and by up to how many radians."""
PLACES = 512
"""Places that are tried for a camera among things."""
AMONG = 0.6
"""Share of directions with something in them from which on a place is among things."""
CELLS, FINE = 3, 4
"""Those directions are told apart by a cube's faces of so many cells each way; finer ones, each."""
BEHIND = 1.1
"""Times the nearest distance in a direction, up to which something there is seen."""
VIEWING = 0.75
"""Least share that a place sees of the subject, of what the best ones see."""
CLEARANCE = 0.25
"""Least distance of such a place from what is there, of the usual one of the freest tenth."""
ASIDE = 0.5
"""Share of that distance by which a camera may stand beside such a place."""
LOOK_AWAY = 0.15
"""Least distance of a target from such a place, share of the radius."""
PITCH = 0.6
"""Sine of the steepest look up or down from there."""

Float64 = NDArray[np.float64]


class FreePlaces(NamedTuple):
    """Places in which a camera could stand.

    Attributes:
        eyes: The places [P, 3].
        clear: How far they are from what is there [P].
    """

    eyes: Float64
    clear: Float64


@dataclass(frozen=True)
class Subject:
    """Opaque Gaussians that do not lie alone: cameras look at these.

    Attributes:
        points: Positions of some of them [S, 3].
        reach: How far each goes from there [S].
        others: As `points`, with those that lie alone [O, 3].
        up: Away from the ground, unit length [3].
        middle: Of a box around the points [3].
        radius: Around the middle, world units.
        opacity: From which on a Gaussian counts.
    """

    points: Float64
    reach: Float64
    others: Float64
    up: Float64
    middle: Float64
    radius: float
    opacity: float

    def holds(self, means: Tensor, opacities: Tensor) -> Tensor:
        """Mask of the Gaussians [G, 3] that count and are no farther off than these, bool [G]."""
        most = (np.linalg.norm(self.points - self.middle, axis=1) + self.reach).max()
        away = torch.linalg.vector_norm(means - torch.from_numpy(self.middle).to(means), dim=1)
        return (away <= float(most)) & (opacities >= self.opacity)


def shown(gaussians: PlainGaussians) -> Float64:
    """About how much of a picture each Gaussian fills: opacity times the area of its face [G]."""
    scales = np.sort(gaussians.log_scales.astype(np.float64), axis=1)
    opacity = 1 / (1 + np.exp(-gaussians.logits.astype(np.float64)))
    return opacity * np.exp(scales[:, 1] + scales[:, 2])


def subject_of(
    gaussians: PlainGaussians, up: tuple[float, float, float], environment: int = 0
) -> Subject:
    """The subject of a scene.

    Args:
        gaussians: The scene.
        up: Away from the ground, unit length.
        environment: So many splats, the first, are known to be a sky.
    """
    chance = np.random.default_rng(0)
    opacity = 1 / (1 + np.exp(-gaussians.logits.astype(np.float64)))
    if environment < len(opacity):
        opacity[:environment] = 0
    least = min(OPACITY, float(np.quantile(opacity, 0.9)) / 2)
    rows = np.flatnonzero(opacity >= least)
    if len(rows) > SAMPLE:
        rows = np.sort(chance.choice(rows, SAMPLE, replace=False))
    others = gaussians.means[rows].astype(np.float64)
    reach = SIGMAS * np.exp(gaussians.log_scales[rows].max(axis=1).astype(np.float64))
    kept = ~alone(others, reach)
    points, reach = others[kept], reach[kept]
    low, high = np.quantile(points, [1 - WHOLE, WHOLE], axis=0)
    middle = (low + high) / 2
    radius = float(np.quantile(np.linalg.norm(points - middle, axis=1) + reach, 0.95))
    return Subject(points, reach, others, np.array(up, float), middle, max(radius, 1e-9), least)


def alone(points: Float64, reach: Float64) -> NDArray[np.bool_]:
    """Mask of the Gaussians that lie alone: floaters, or parts of a far sky, bool [S].

    In thin parts it does that neither fills the gap to its neighbours, as a plain wall's do, nor
    is near what is dense.
    """
    count = min(max(NEIGHBOURS, len(points) // 100), len(points) - 1)
    if count < 1:
        return np.zeros(len(points), bool)
    gap = np.asarray(KDTree(points).query(points, k=count + 1)[0])[:, -1]
    sparse = gap > SPARSE * np.quantile(gap, 0.25)
    dense = points[~sparse]
    away = np.linalg.norm(points - np.median(dense, axis=0), axis=1)
    far = away > FAR * np.quantile(away[~sparse], 0.9)
    return sparse & (far | (gap > GAP * reach))


def lens_of(width: int) -> Camera:
    """The lens of all these cameras, for pictures of a width, pixels."""
    return default_lens().scaled(default_lens().width / width)


def cameras_around(
    subject: Subject, count: int, lens: Camera, seed: int, zooms: tuple[float, float]
) -> list[Camera]:
    """Cameras that stand around a subject; other seeds give others.

    Args:
        subject: What they look at.
        count: How many.
        lens: Of their pictures.
        seed: Of chance.
        zooms: How far off, least and most: times the distance at which all of it is seen.
    """
    chance = np.random.default_rng(seed)
    lift = STEEPER * max(0.0, 1 - _flatness(subject) / FLAT)
    turns = np.arange(count) / count + chance.random(count) / count
    tilts = lift + ELEVATIONS[0] + chance.random(count) * (ELEVATIONS[1] - ELEVATIONS[0])
    ranges = chance.uniform(*zooms, count)
    return [camera_at(subject, lens, *how) for how in zip(turns, tilts, ranges, strict=True)]


def camera_at(
    subject: Subject, lens: Camera, turn: float, tilt: float, zoom: float = WHOLLY[0]
) -> Camera:
    """A camera that stands at one side of a subject, as near as it sees all of it, times `zoom`."""
    up = subject.up
    side = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    side /= np.linalg.norm(side)
    flat = np.cos(2 * np.pi * turn) * side + np.sin(2 * np.pi * turn) * np.cross(up, side)
    away = np.cos(tilt) * flat + np.sin(tilt) * up
    turned = look_at(away, np.zeros(3), up)[:3, :3]
    x, y, z = turned @ (subject.points - subject.middle).T
    wide = (np.abs(x) + subject.reach) * 2 * lens.fx / lens.width
    high = (np.abs(y) + subject.reach) * 2 * lens.fy / lens.height
    distance = float(np.quantile(np.maximum(wide, high) - z, WHOLE))
    eye = subject.middle + zoom * max(distance, subject.radius) * away
    return _placed(lens, eye, subject.middle, up)


def cameras_among(
    subject: Subject, places: FreePlaces, count: int, lens: Camera, seed: int
) -> list[Camera]:
    """Cameras in free places that look at what is there; other seeds give others."""
    chance = np.random.default_rng(seed)
    order = chance.permutation(len(places.eyes))
    cameras: list[Camera] = []
    for number in range(count):
        row = order[number % len(order)]
        aside = chance.uniform(-1, 1, 3)
        eye = places.eyes[row] + ASIDE * places.clear[row] * aside / np.linalg.norm(aside)
        sight = subject.points - eye
        far = np.linalg.norm(sight, axis=1)
        level = np.abs(sight @ subject.up) <= PITCH * far
        away = far > LOOK_AWAY * subject.radius
        fit = away & level if (away & level).any() else far >= np.median(far)
        target = chance.choice(subject.points[fit])
        cameras.append(_placed(lens, eye, target, subject.up))
    return cameras


def free_places(subject: Subject) -> FreePlaces:
    """Places with things on most sides and none right beside them, from which much is seen."""
    chance = np.random.default_rng(0)
    low, high = np.quantile(subject.points, [1 - WHOLE, WHOLE], axis=0)
    spread = (chance.random((PLACES, 3)) - 0.5) * (0.3 + 1.7 * chance.random((PLACES, 1)))
    eyes = subject.middle + spread * (high - low)
    some = subject.others[:: max(1, len(subject.others) // 4096)]
    around, seen = np.array([_surroundings(some - eye) for eye in eyes]).T
    among = around >= AMONG
    if not among.any() or len(some) < NEIGHBOURS:
        return FreePlaces(eyes[:0], eyes[:0, 0])
    eyes, seen = eyes[among], seen[among]
    tree = KDTree(some)
    clear = np.asarray(tree.query(eyes, k=3)[0])[:, -1]
    usual = float(np.median(np.asarray(tree.query(some, k=4)[0])[:, -1]))
    free = clear > max(CLEARANCE * float(np.quantile(clear, 0.9)), 2 * usual)
    free &= seen >= VIEWING * np.quantile(seen, 0.95)
    return FreePlaces(eyes[free], clear[free])


def _placed(lens: Camera, eye: Float64, target: Float64, up: Float64) -> Camera:
    w2c = look_at(eye, target, up)
    return Camera(lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy, w2c)


def _flatness(subject: Subject) -> float:
    """Height by width."""
    along = (subject.points - subject.middle) @ subject.up
    across = subject.points - subject.middle - along[:, None] * subject.up
    low, high = np.quantile(along, [1 - WHOLE, WHOLE])
    width = 2 * float(np.quantile(np.linalg.norm(across, axis=1), 0.9))
    return (float(high - low) + float(np.median(subject.reach))) / max(width, 1e-12)


def _surroundings(away: Float64) -> tuple[float, float]:
    """Share of directions in which there is something, and of the points that nothing hides."""
    side = CELLS * FINE
    distance = np.linalg.norm(away, axis=1)
    axis = np.abs(away).argmax(axis=1)
    rows = np.arange(len(away))
    main = away[rows, axis]
    others = np.stack([away[rows, (axis + 1) % 3], away[rows, (axis + 2) % 3]], axis=1)
    cell = np.floor((others / np.abs(main)[:, None].clip(1e-12) + 1) / 2 * side)
    cell = np.clip(cell, 0, side - 1).astype(np.int64)
    face = 2 * axis + (main > 0)
    fine = (face * side + cell[:, 0]) * side + cell[:, 1]
    nearest = np.full(6 * side * side, np.inf)
    np.minimum.at(nearest, fine, distance)
    coarse = (face * CELLS + cell[:, 0] // FINE) * CELLS + cell[:, 1] // FINE
    around = len(np.unique(coarse)) / (6 * CELLS * CELLS)
    return around, float((distance <= BEHIND * nearest[fine]).mean())
