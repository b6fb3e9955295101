"""Points and cameras that lie so far outside a scene that they must not decide its size.

Every real reconstruction has some: points of wrong matches, images registered at a wrong place. One
of them would decide a box, a mean or a largest distance. So radii are order statistics, and points
much farther are left out. Limits are wide, for skies and distant hills are not mistakes.
"""

import numpy as np
from numpy.typing import NDArray

STRAY_POINTS = 0.02
"""Share of the points that may be wrong; a distance that more of them have is the scene's."""
STRAY_CAMERAS = 0.05
"""Share of the cameras that may be wrong."""
FAR = 30.0
"""Times the radius of all others. Real and procedural scenes reach 3.5 times."""
FARTHEST = 1e4
"""Times the cameras' extent or the median distance of the points, whatever their number: over such
a distance no baseline between the cameras gives a parallax of a pixel."""


def far_cameras(places: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Mask of the camera centres [C, 3] that lie far outside the others, bool [C].

    None are far if nearly all stand in one place, for then there is no scale to measure by.
    """
    away = places - np.median(places, axis=0)
    distance = np.linalg.norm(away, axis=1)
    radius = _radius(distance, STRAY_CAMERAS)
    if radius <= 1e-12 * float(np.median(np.abs(places).max(axis=1))):
        return np.zeros(len(places), np.bool_)
    return distance > FAR * radius


def far_points(points: NDArray[np.float64], extent: float) -> NDArray[np.bool_]:
    """Mask of the points [P, 3] that lie far outside a scene, bool [P].

    Args:
        points: Finite, of any size.
        extent: Reach of the cameras, world units.
    """
    if not len(points):
        return np.zeros(0, np.bool_)
    with np.errstate(over="ignore"):
        distance = np.abs(points - np.median(points, axis=0)).max(axis=1)
        near = FAR * max(_radius(distance, STRAY_POINTS), extent)
        farthest = FARTHEST * max(float(np.median(distance)), extent)
    return distance > min(near, farthest)


def _radius(distance: NDArray[np.float64], stray: float) -> float:
    """The distance that all but a share of them do not exceed; always one of the distances."""
    return float(np.quantile(distance, 1 - stray, method="lower"))
