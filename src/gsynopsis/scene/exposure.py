"""How photos of one scene differ in exposure and white balance, measured at the sparse points.

A point's colour is the mean over the photos that see it, so the ratio of a photo's pixels to the
colours of its points says how bright the photo is. Points that something hides are outvoted: the
median counts.
"""

import numpy as np
from numpy.typing import NDArray

from gsynopsis.scene.scene import Scene

COARSE_PIXELS = 256
"""Width at which photos are looked at."""
MOST_POINTS = 4_000
MOST_PHOTOS = 48
"""Photos that are looked at to decide; all are when exposure is learnt."""
DARK, BRIGHT = 20, 235
"""Of 255: values outside are cut off in some photo."""
FEWEST_POINTS = 30
"""A photo with fewer points in frame says nothing."""
DIFFERENT = 0.06
"""Standard deviation of log brightness from which photos differ; see docs/methods.md §2.13."""


def log_gains(scene: Scene, views: tuple[int, ...]) -> NDArray[np.float64]:
    """Log of how bright each photo is beside the mean of all, by channel, float64 [n, 3].

    Args:
        scene: Its points have colours.
        views: Which photos.
    """
    step = max(1, len(scene.points) // MOST_POINTS)
    points, colors = scene.points[::step], scene.colors[::step].astype(np.float64)
    gains = np.stack([_log_gain(scene, view, points, colors) for view in views])
    return gains - gains.mean(axis=0)


def brightness_spread(scene: Scene) -> float:
    """Standard deviation of the log brightness and of the log colour balance of photos.

    The larger of both; 0.1 is ten percent.
    """
    step = max(1, len(scene.train) // MOST_PHOTOS)
    gains = log_gains(scene, scene.train[::step])
    balance = gains - gains.mean(axis=1, keepdims=True)
    return float(max(gains.mean(axis=1).std(), balance.std(axis=0).max()))


def _log_gain(
    scene: Scene, view: int, points: NDArray[np.float64], colors: NDArray[np.float64]
) -> NDArray[np.float64]:
    factor = max(1.0, scene.views[view].camera.width / COARSE_PIXELS)
    framed = scene.camera(view, factor).framed(points)
    seen = scene.image(view, factor)[framed.rows, framed.columns].astype(np.float64)
    known = colors[framed.which]
    usable = ((seen > DARK) & (seen < BRIGHT) & (known > DARK) & (known < BRIGHT)).all(axis=1)
    if usable.sum() < FEWEST_POINTS:
        return np.zeros(3)
    return np.median(np.log(seen[usable] / known[usable]), axis=0)
