"""Bjøntegaard delta rate: how many more bytes one curve needs than another for the same quality.

G. Bjøntegaard, "Calculation of average PSNR differences between RD-curves", VCEG-M33 (2001), with
monotone piecewise-cubic interpolation (PCHIP) of log bytes over PSNR instead of one cubic, which
swings between points; this is what VCEG and JVET use since.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Points = Sequence[tuple[float, float]]
"""Bytes, above 0, and PSNR in dB of each level, in any order."""


@dataclass(frozen=True)
class BdRate:
    """Bytes of one curve over those of another, averaged over the qualities that both reach.

    Attributes:
        percent: Bytes more (or less, if negative) for the same PSNR, mean in the log domain.
        low: The smallest PSNR that both curves reach, dB.
        high: The largest.
    """

    percent: float
    low: float
    high: float


def bd_rate(anchor: Points, other: Points) -> BdRate | None:
    """Percent more bytes that `other` needs than `anchor`; negative if it needs fewer.

    Points that another one of their curve beats, in fewer bytes at least as good, are left out.

    Args:
        anchor: Curve to compare with.
        other: Curve to compare.

    Returns:
        None if a curve has fewer than two points left, or there is no quality that both reach.
    """
    from scipy.interpolate import PchipInterpolator  # pyright: ignore[reportMissingTypeStubs]

    curves = [frontier(points) for points in (anchor, other)]
    if min(len(curve) for curve in curves) < 2:
        return None
    low = max(curve[0, 1] for curve in curves)
    high = min(curve[-1, 1] for curve in curves)
    if high <= low:
        return None
    splines: list[Any] = [PchipInterpolator(curve[:, 1], np.log(curve[:, 0])) for curve in curves]
    means = [float(spline.integrate(low, high)) for spline in splines]
    percent = 100 * float(np.expm1((means[1] - means[0]) / (high - low)))
    return BdRate(percent, float(low), float(high))


def frontier(points: Points) -> NDArray[np.float64]:
    """Points that no other beats, float64 [n, 2], bytes and PSNR both rising."""
    best: list[tuple[float, float]] = []
    for size, quality in sorted(points, key=lambda point: (point[0], -point[1])):
        if not best or quality > best[-1][1]:
            best.append((size, quality))
    return np.array(best, np.float64).reshape(-1, 2)
