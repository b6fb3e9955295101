"""Subject of a scene of splats, and cameras that stand around all of it (ours)."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from gsynopsis.cameras.orbit import default_lens
from gsynopsis.records import PlainGaussians
from gsynopsis.scene.camera import Camera, look_at

SAMPLE = 16384
"""Gaussians that stand for all, drawn by number: detail is where there are many."""
OPACITY = 0.1
"""Fainter ones do not count, unless almost all are faint."""
PIECE = 1 << 20
"""Gaussians that are looked at at once: memory stays small beside that of all of them."""
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

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class Subject:
    """Opaque Gaussians that do not lie alone: cameras look at these.

    Attributes:
        points: Positions of some of them [S, 3].
        reach: How far each goes from there [S].
        sizes: Root of the product of its two larger standard deviations, world units [S].
        others: As `points`, with those that lie alone [O, 3].
        up: Away from the ground, unit length [3].
        middle: Of a box around the points [3].
        radius: Around the middle, world units.
        opacity: From which on a Gaussian counts.
        harmonics: Of the points' colors, degrees from 1 on [S, K, 3].
    """

    points: Float64
    reach: Float64
    sizes: Float64
    others: Float64
    up: Float64
    middle: Float64
    radius: float
    opacity: float
    harmonics: NDArray[np.float32]


def shown(gaussians: PlainGaussians) -> Float64:
    """About how much of a picture each Gaussian fills: opacity times the area of its face [G]."""
    out = np.empty(len(gaussians))
    for start in range(0, len(out), PIECE):
        rows = slice(start, start + PIECE)
        scales = np.sort(gaussians.log_scales[rows].astype(np.float64), axis=1)
        opacity = 1 / (1 + np.exp(-gaussians.logits[rows].astype(np.float64)))
        out[rows] = opacity * np.exp(scales[:, 1] + scales[:, 2])
    return out


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
    scales = np.sort(gaussians.log_scales[rows[kept]].astype(np.float64), axis=1)
    sizes = np.exp((scales[:, 1] + scales[:, 2]) / 2)
    low, high = np.quantile(points, [1 - WHOLE, WHOLE], axis=0)
    middle = (low + high) / 2
    radius = float(np.quantile(np.linalg.norm(points - middle, axis=1) + reach, 0.95))
    up_axis, harmonics = np.array(up, float), gaussians.sh[rows[kept], 1:]
    return Subject(
        points, reach, sizes, others, up_axis, middle, max(radius, 1e-9), least, harmonics
    )


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


def camera_at(
    subject: Subject, lens: Camera, turn: float, tilt: float, zoom: float = 1.0
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
    return replace(lens, w2c=look_at(eye, subject.middle, up))
