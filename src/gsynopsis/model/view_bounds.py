"""Bounds of the training views, as a note in the file: the heads know no other views.

They take direction and distance from the eye, and extrapolate badly: from far away colours turn to
neon. So an eye outside the cameras of training decodes what the nearest eye among them does.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

SLACK = 1.01
"""Distances may be so much outside those of training: rounding never decides."""
DIGITS = 9
"""Significant digits of numbers in the note; they give every float32 back."""
Point = tuple[float, float, float]


@dataclass(frozen=True)
class ViewBounds:
    """Bounds of the training cameras' positions and of their distances to anchors.

    Attributes:
        center: Centre of a ball that holds the cameras, world units.
        radius: Its radius, world units, > 0.
        low: Smallest distance input of the heads, in units of the frame's extent, a float32.
        high: Largest one, a float32.
    """

    center: Point
    radius: float
    low: float
    high: float

    def nearest(self, eye: Point) -> Point:
        """The eye itself within the ball, else the point of the ball nearest to it."""
        x, y, z = (e - c for e, c in zip(eye, self.center, strict=True))
        far = math.sqrt(x * x + y * y + z * z)
        if far <= self.radius:
            return eye
        share = self.radius / far
        a, b, c = self.center
        return a + x * share, b + y * share, c + z * share


def view_bounds_of(eyes: NDArray[np.float64], anchors: Tensor, extent: float) -> ViewBounds:
    """View bounds of cameras at `eyes` and of anchors, whatever the cameras' direction.

    Args:
        eyes: Positions of the cameras of training [C, 3], C ≥ 1.
        anchors: Positions [N, 3], N ≥ 1, world units.
        extent: Of the frame: a tenth more than the cameras' largest distance from their mean.
    """
    places = torch.from_numpy(eyes).to(anchors.device, anchors.dtype)
    away = torch.stack([torch.stack((anchors - eye).norm(dim=1).aminmax()) for eye in places])
    low, high = float(away[:, 0].min()) / extent, float(away[:, 1].max()) / extent
    x, y, z = (_short(value) for value in eyes.mean(axis=0))
    return ViewBounds((x, y, z), _short(extent), _single(low / SLACK), _single(high * SLACK))


def view_bounds_text(seen: ViewBounds) -> str:
    """The note, JSON."""
    values = {
        "center": list(seen.center),
        "radius": seen.radius,
        "distance": [_short(seen.low), _short(seen.high)],
    }
    return json.dumps(values, separators=(",", ":"))


def parse_view_bounds(text: str | None) -> ViewBounds | None:
    """View bounds from a note; None without a valid note."""
    try:
        values = json.loads(text or "")
        x, y, z = finite_numbers(values["center"])
        low, high = finite_numbers(values["distance"])
        (radius,) = finite_numbers([values["radius"]])
    except (ValueError, LookupError, TypeError, OverflowError, RecursionError):
        return None
    low, high = _single(low), _single(high)
    if not radius > 0 or not 0 <= low <= high < math.inf:
        return None
    return ViewBounds((x, y, z), radius, low, high)


def finite_numbers(values: Sequence[object]) -> list[float]:
    """Numbers of a note; a `TypeError`, `ValueError` or `OverflowError` if one is none."""
    found: list[float] = []
    for value in values:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise TypeError
        if not math.isfinite(value):
            raise ValueError
        found.append(float(value))
    return found


def _short(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def _single(value: float) -> float:
    with np.errstate(over="ignore"):
        return float(np.float32(value))
