"""Blocks of space: boxes that divide a scene, and a training that moves the anchors of one.

A scene too large for one training is split in space. Each block starts from a training of the
whole, moves the anchors in its own box and a margin around it, and sees all others as the whole has
them; networks stay those of the whole, so that the blocks are one file afterwards (methods.md
§2.15).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

INFINITY = float("inf")
EXTENT = (0.02, 0.98)
"""Quantiles of the points between which a block is measured: few far ones would decide it."""


@dataclass(frozen=True)
class Region:
    """A box of space, world units; sides may lie at infinity. Its low faces belong to it.

    Attributes:
        low: Low corner.
        high: High corner.
    """

    low: tuple[float, float, float] = (-INFINITY, -INFINITY, -INFINITY)
    high: tuple[float, float, float] = (INFINITY, INFINITY, INFINITY)

    def holds(self, x: Tensor) -> Tensor:
        """Mask of the positions float32 [N, 3] inside, bool [N]."""
        low, high = x.new_tensor(self.low), x.new_tensor(self.high)
        return ((x >= low) & (x < high)).all(dim=1)

    def wider(self, margin: Sequence[float]) -> "Region":
        """The box with so much more on either side of each axis."""
        low = [a - m for a, m in zip(self.low, margin, strict=True)]
        high = [a + m for a, m in zip(self.high, margin, strict=True)]
        return Region((low[0], low[1], low[2]), (high[0], high[1], high[2]))


def split_space(points: NDArray[np.float32], count: int) -> list[Region]:
    """Boxes that divide all of space, with about as many points in each.

    The box that is to hold several blocks is cut across its longest side, again and again.

    Args:
        points: float32 [N, 3]; at least one a block.
        count: Blocks, ≥ 1.

    Returns:
        The boxes: every position lies in exactly one.
    """
    return _split(points, count, Region())


def extents(points: NDArray[np.float32]) -> NDArray[np.float64]:
    """Size of what holds nearly all of the points, float64 [3]; 0 without any."""
    if not len(points):
        return np.zeros(3)
    low, high = np.quantile(points.astype(np.float64), EXTENT, axis=0)
    return high - low


def _split(points: NDArray[np.float32], count: int, box: Region) -> list[Region]:
    if count == 1:
        return [box]
    axis = int(extents(points).argmax())
    first = count // 2
    along = np.sort(points[:, axis])
    place = min(max(1, len(along) * first // count), max(1, len(along) - 1))
    # A float32 that is a point's own coordinate: that point is the first on the high side.
    cut = float(along[place]) if place < len(along) else 0.0
    inside = points[:, axis] < cut
    return [
        *_split(points[inside], first, _moved(box, "high", axis, cut)),
        *_split(points[~inside], count - first, _moved(box, "low", axis, cut)),
    ]


def _moved(box: Region, side: Literal["low", "high"], axis: int, place: float) -> Region:
    """The box with one of its faces elsewhere."""
    corner = list(getattr(box, side))
    corner[axis] = place
    return replace(box, **{side: (corner[0], corner[1], corner[2])})
