"""Evidence that photos of one scene differ in exposure or white balance.

The same surface point looks brighter in one photo than in another. So the logarithm of a pixel is
the sum of its photo's gain and its point's colour, and both follow from many points in many photos
by a robust fit. A gain counts only where the photo really shows the point, and it is exposure only
if all parts of the photo have it: an occluder or a light on a part of a photo is not a gain.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gsynopsis.scene.camera import positions_of
from gsynopsis.scene.observations import Observations, observed
from gsynopsis.scene.scene import Scene

COARSE_PIXELS = 256
"""Width at which photos are compared."""
DARK, BRIGHT = 20, 235
"""Range of unclipped values, of 255: values outside are cut off in some photo."""
FEWEST = 30
"""Observations in a photo below which its gain is not measured."""
ROUNDS = 20
"""Iterations of the robust fit: each at least halves the remaining change."""
SMALLEST_RESIDUAL = 0.02
"""Residuals count as at least this, in log brightness: about the noise of a pixel."""
CENTRE = 0.5**0.5
"""Half of a photo's pixels are within this distance of its middle, of the way to its edge."""
NEIGHBOURS = 3
"""Nearest views that predict a view's gain."""
AGREEMENT = 0.5
"""Least correlation of the gains of either half of the photos."""
EXPLAINED = 0.15
"""Least share by which the gains lower the median residual."""
UNPREDICTED = 0.08
"""Least standard deviation of log gains that nearby views do not predict."""
UNPREDICTED_SHARE = 0.5
"""The same limit as a share of the standard deviation of all gains."""

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class Evidence:
    """Evidence of exposure differences, from observations of the same points in several photos.

    Attributes:
        gains: Log of each training photo's gain by channel, mean 0, [V, 3].
        agreement: Least correlation between halves of each photo (left and right, top and bottom,
            centre and border) of the part of its gains that nearby views do not predict.
        explained: Share by which gains lower the median residual of an observation, 0 to 1.
        spread: Standard deviation of log gains (of brightness or of colour, the larger).
        unpredicted: Standard deviation of the part that the nearest views do not predict.
    """

    gains: Float64
    agreement: float
    explained: float
    spread: float
    unpredicted: float

    @property
    def sufficient(self) -> bool:
        """Enough to try whether solving exposure helps; not a proof that it does."""
        return not self.rejection

    @property
    def rejection(self) -> str:
        """Why there is nothing to try; empty if there is."""
        if self.agreement < AGREEMENT or self.explained < EXPLAINED:
            return "photos of the same points do not differ alike in brightness or white balance"
        if self.unpredicted < max(UNPREDICTED, UNPREDICTED_SHARE * self.spread):
            return f"photos differ by {self.spread:.0%}, as nearby views predict"
        return ""


def exposure_evidence(scene: Scene) -> Evidence:
    """Evidence of exposure differences among a scene's training photos; decodes each, small."""
    seen = observed(scene)
    values, places, good = _log_values(scene, seen)
    seen, values, places = seen.of(good), values[good], places[good]
    count = len(scene.train)
    gains, colors = _fit(seen, values, count)
    nearest = _nearest(scene)
    left = _residual(values - gains[seen.views] - colors[seen.points])
    before = _residual(values - _colors(seen, values)[seen.points])
    brightness, balance = _parts(gains)
    unpredicted_parts = [_unpredicted_deviation(part, nearest) for part in (brightness, balance)]
    spreads = [_deviation(part) for part in (brightness, balance)]
    which = int(np.argmax(spreads))
    return Evidence(
        gains=gains,
        agreement=min(_agreement(seen, values, half, nearest) for half in _halves(places)),
        explained=1 - left / before if before > 0 else 0.0,
        spread=spreads[which],
        unpredicted=unpredicted_parts[which],
    )


def _log_values(scene: Scene, seen: Observations) -> tuple[Float64, Float64, NDArray[np.bool_]]:
    """Log of the observed pixels [O, 3], their places in the photo, and a mask of usable ones [O].

    Places are from -1 to 1 [O, 2]. Usable pixels have no clipped channel and are inside the mask.
    """
    values, places = np.zeros((len(seen), 3)), np.zeros((len(seen), 2))
    for row, view in enumerate(scene.train):
        own = np.flatnonzero(seen.views == row)
        factor = max(1.0, scene.views[view].camera.width / COARSE_PIXELS)
        camera = scene.camera(view, factor)
        framed = camera.framed(seen.places[seen.points[own]])
        own, inside = own[framed.which], scene.inside(view, factor)
        shown = scene.image(view, factor)[framed.rows, framed.columns]
        if inside is not None:  # zeros are cut off
            shown = shown * inside[framed.rows, framed.columns, None]
        values[own] = shown
        places[own, 0] = 2 * framed.columns / camera.width - 1
        places[own, 1] = 2 * framed.rows / camera.height - 1
    good = np.all((values > DARK) & (values < BRIGHT), axis=1, keepdims=True)[:, 0]
    return np.log(np.maximum(values, 1)), places, good


def _fit(seen: Observations, values: Float64, views: int) -> tuple[Float64, Float64]:
    """Log gains [V, 3] of mean 0 and log colours [P, 3] with the least absolute residuals."""
    gains = np.zeros((views, 3))
    weights = np.ones(len(values))
    colors = _colors(seen, values, weights)
    for _ in range(ROUNDS):
        own = values - colors[seen.points]
        totals = _sums(seen.views, own * weights[:, None], views)
        mass = _sums(seen.views, weights[:, None], views)
        counts = np.bincount(seen.views, minlength=views)
        gains = np.where(counts[:, None] >= FEWEST, totals / np.maximum(mass, 1e-12), 0.0)
        gains -= gains.mean(axis=0)
        colors = _colors(seen, values - gains[seen.views], weights)
        residuals = np.abs(values - gains[seen.views] - colors[seen.points]).mean(axis=1)
        weights = 1 / np.maximum(residuals, SMALLEST_RESIDUAL)
    return gains, colors


def _colors(seen: Observations, values: Float64, weights: Float64 | None = None) -> Float64:
    weights = np.ones(len(values)) if weights is None else weights
    mass = _sums(seen.points, weights[:, None], len(seen.places))
    return _sums(seen.points, values * weights[:, None], len(seen.places)) / np.maximum(mass, 1e-12)


def _sums(groups: NDArray[np.int64], values: Float64, count: int) -> Float64:
    found = np.zeros((count, values.shape[1]))
    for channel, column in enumerate(values.T):
        found[:, channel] = np.bincount(groups, column, count)
    return found


def _residual(residuals: Float64) -> float:
    return float(np.median(np.abs(residuals).mean(axis=1))) if len(residuals) else 0.0


def _halves(places: Float64) -> list[NDArray[np.bool_]]:
    """Observations in the right, the lower and the outer half of their photos; places [O, 2]."""
    outer = (np.abs(places) > CENTRE).any(axis=1)
    return [places[:, 0] > 0, places[:, 1] > 0, outer]


def _agreement(
    seen: Observations, values: Float64, half: NDArray[np.bool_], nearest: NDArray[np.int64]
) -> float:
    """Correlation of what nearby views do not predict of either half's gains."""
    views = len(nearest)
    apart = Observations(seen.places, 2 * seen.views + half, seen.points)
    gains, _ = _fit(apart, values, 2 * views)
    counts = np.bincount(apart.views, minlength=2 * views)
    both = (counts.reshape(-1, 2) >= FEWEST).all(axis=1)
    if 2 * both.sum() < views:
        return 0.0
    one, other = (_unpredicted(gains[side::2], nearest)[both] for side in (0, 1))
    return _correlation(one - one.mean(axis=0), other - other.mean(axis=0))


def _parts(gains: Float64) -> tuple[Float64, Float64]:
    """Brightness [V, 1] and colour balance [V, 3] of log gains [V, 3]."""
    brightness = gains.mean(axis=1, keepdims=True)
    return brightness, gains - brightness


def _deviation(part: Float64) -> float:
    return float(part.std(axis=0).max())


def _nearest(scene: Scene) -> NDArray[np.int64]:
    """Rows of the views with the nearest poses, for each training view, [V, n]."""
    cameras = [scene.views[view].camera for view in scene.train]
    places = positions_of(cameras) / scene.extent
    looks = np.stack([camera.forward for camera in cameras])
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    apart += np.linalg.norm(looks[:, None] - looks[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    return np.argsort(apart, axis=1, kind="stable")[:, : min(NEIGHBOURS, len(cameras) - 1)]


def _unpredicted(part: Float64, nearest: NDArray[np.int64]) -> Float64:
    """Each view's part [V, c] of the gains without the mean of the nearest views'."""
    count = nearest.shape[1]
    if not count:
        return np.zeros_like(part)
    # Of independent gains the mean of n neighbours adds a variance of 1/n.
    return (part - part[nearest].mean(axis=1)) / (1 + 1 / count) ** 0.5


def _unpredicted_deviation(part: Float64, nearest: NDArray[np.int64]) -> float:
    return _deviation(_unpredicted(part, nearest))


def _correlation(one: Float64, other: Float64) -> float:
    a, b = one.ravel(), other.ravel()
    size = float(np.sqrt((a**2).sum() * (b**2).sum()))
    return float((a * b).sum()) / size if size > 0 else 0.0
