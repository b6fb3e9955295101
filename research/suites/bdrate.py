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
LEAST_RANGE = 1.0
"""Decibels that two curves have to share before a rate says anything (ours)."""
LEAST_SPREADS = 3.0
"""As many spreads of one training they have to share, too (ours)."""


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


def bd_psnr(anchor: Points, other: Points) -> float | None:
    """Decibels that `other` has more than `anchor` in the same bytes, mean over log bytes.

    Arguments and what is left out as in `bd_rate`; None if there are no bytes that both have.
    """
    from scipy.interpolate import PchipInterpolator  # pyright: ignore[reportMissingTypeStubs]

    curves = [frontier(points) for points in (anchor, other)]
    if min(len(curve) for curve in curves) < 2:
        return None
    low = float(np.log(max(curve[0, 0] for curve in curves)))
    high = float(np.log(min(curve[-1, 0] for curve in curves)))
    if high <= low:
        return None
    splines: list[Any] = [PchipInterpolator(np.log(curve[:, 0]), curve[:, 1]) for curve in curves]
    means = [float(spline.integrate(low, high)) / (high - low) for spline in splines]
    return means[1] - means[0]


def shared_range(rates: Sequence[BdRate]) -> tuple[float, float]:
    """The smallest and the largest PSNR that all of some rates are over, dB; at least one rate."""
    return max(rate.low for rate in rates), min(rate.high for rate in rates)


def is_wide(rates: Sequence[BdRate], spread: float) -> bool:
    """True if the PSNR that all rates are over spans `LEAST_RANGE` and `LEAST_SPREADS` spreads.

    Args:
        rates: Of the seeds of one comparison.
        spread: Standard deviation of the PSNR of one training, dB, see `pooled_spread`.
    """
    if not rates:
        return False
    low, high = shared_range(rates)
    return high - low >= max(LEAST_RANGE, LEAST_SPREADS * spread)


def pooled_spread(groups: Sequence[Sequence[float]]) -> float:
    """Standard deviation within groups, all of them together; 0 where none has a second value."""
    free = sum(len(group) - 1 for group in groups)
    if free < 1:
        return 0.0
    squares = sum(float(np.square(np.array(g) - np.mean(g)).sum()) for g in groups if len(g) > 1)
    return (squares / free) ** 0.5


def frontier(points: Points) -> NDArray[np.float64]:
    """Points that no other beats, float64 [n, 2], bytes and PSNR both rising."""
    best: list[tuple[float, float]] = []
    for size, quality in sorted(points, key=lambda point: (point[0], -point[1])):
        if not best or quality > best[-1][1]:
            best.append((size, quality))
    return np.array(best, np.float64).reshape(-1, 2)
