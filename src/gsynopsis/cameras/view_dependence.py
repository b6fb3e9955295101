"""Directions that photos were taken from, as colors that change with the direction tell (ours).

Training fits a splat's spherical harmonics to the photos that see it. Begun at zero, they change
its color most in the directions of these photos and little in others.
"""

import numpy as np
from numpy.typing import NDArray

from gsynopsis.formats.axes import harmonic_values

Float64 = NDArray[np.float64]
DIRECTIONS, ASKED = 192, 1024
"""On the sphere, for the mean direction of photos; and points that are asked."""
FAINT = 1e-3
"""Root mean square change of a color, of 1, that tells nothing: rounding of a file."""


def photo_direction(harmonics: NDArray[np.float32]) -> Float64:
    """Mean direction [3] from points to where photos were taken.

    Its length is 0 where they were taken from all sides, or nothing is known, and about 0.5 where
    they were taken from one.

    Args:
        harmonics: Coefficients of degrees from 1 on [P, K, 3]; K is 0 where colors do not change.
    """
    to, some = on_sphere(DIRECTIONS), harmonics[every(len(harmonics))]
    changes = np.array([color_change(some, -one[None]) for one in to])
    return 3 * ((changes - changes.mean())[:, None] * to).mean(axis=0)


def color_change(harmonics: NDArray[np.float32], away: Float64) -> float:
    """Change of points' colors in the directions they are seen along, of that in all directions.

    Above 1 where photos looked so; 1 where colors hardly change.

    Args:
        harmonics: As in `photo_direction`.
        away: Directions of any length [P, 3], or one for all [1, 3].
    """
    count = harmonics.shape[1]
    if not count or not len(harmonics):
        return 1.0
    own = harmonics.astype(np.float64)
    mean = np.sqrt((own**2).sum(axis=(1, 2)) / (4 * np.pi))
    if mean.mean() < FAINT:
        return 1.0
    along = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-300)
    values = harmonic_values(along, 1 + count)[:, 1:]
    changes = np.linalg.norm((values[:, None, :] @ own)[:, 0], axis=1)
    return float(changes.sum() / mean.sum())


def every(count: int) -> slice:
    """Some of so many points: `ASKED` or a few more, evenly."""
    return slice(None, None, max(1, count // ASKED))


def on_sphere(count: int) -> Float64:
    """Directions, evenly on a sphere along a spiral from its upper pole to the lower one [D, 3]."""
    number = np.arange(count) + 0.5
    z, turn = 1 - 2 * number / count, np.pi * (1 + np.sqrt(5)) * number
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
