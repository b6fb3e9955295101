"""Directions that photos were taken from, as colors that change with the direction tell (ours).

Training fits a splat's spherical harmonics to the photos that see it. Begun at zero, they change
its color most in the directions of these photos and little in others.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gsynopsis.formats.axes import harmonic_values

Float64 = NDArray[np.float64]
DIRECTIONS, ASKED = 192, 1024
"""On the sphere, for the mean direction of photos; and points that are asked."""
FAINT = 1e-3
"""Root mean square change of a color, of 1, that tells nothing: rounding of a file."""


@dataclass(frozen=True)
class ViewDependence:
    """Harmonics of some points.

    Attributes:
        points: Positions [P, 3].
        harmonics: Coefficients of degrees from 1 on [P, K, 3]; K is 0 where colors do not change.
    """

    points: Float64
    harmonics: NDArray[np.float32]

    def towards(self, place: Float64, rows: NDArray[np.int64]) -> float:
        """Change of the points' colors as seen from a place, 1 if it is that of all directions.

        Above 1 where photos looked from there; 1 where colors hardly change.
        """
        rows = rows[:: max(1, len(rows) // ASKED)]
        return self._change(self.points[rows] - place, rows)

    def mean_direction(self) -> Float64:
        """From the points to where photos were taken, on the mean [3].

        Its length is 0 where they were taken from all sides, or nothing is known, and about 0.5
        where they were taken from one.
        """
        number = np.arange(DIRECTIONS) + 0.5
        z, turn = 1 - 2 * number / DIRECTIONS, np.pi * (1 + np.sqrt(5)) * number
        flat = np.sqrt(1 - z * z)
        to = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
        rows = np.arange(0, len(self.points), max(1, len(self.points) // ASKED))
        changes = np.array([self._change(np.tile(-one, (len(rows), 1)), rows) for one in to])
        return 3 * ((changes - changes.mean())[:, None] * to).mean(axis=0)

    def _change(self, away: Float64, rows: NDArray[np.int64]) -> float:
        """Change of colors seen along directions [N, 3], of its mean over the sphere."""
        count = self.harmonics.shape[1]
        if not count or not len(rows):
            return 1.0
        own = self.harmonics[rows].astype(np.float64)
        mean = np.sqrt((own**2).sum(axis=(1, 2)) / (4 * np.pi))
        if mean.mean() < FAINT:
            return 1.0
        along = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-300)
        values = harmonic_values(along, 1 + count)[:, 1:]
        changes = np.linalg.norm((values[:, None, :] @ own)[:, 0], axis=1)
        return float(changes.sum() / mean.sum())
