"""The first view, as a file's notes tell it: what of the base is seen from there."""

import json
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gsynopsis.container.layout import FAR

MIDDLE = 2.0
"""Falloff of weights towards the edges of the view."""

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class FirstView:
    """The pose of a photo and its field of view.

    Attributes:
        w2c: World to camera, OpenCV axes [3, 4].
        half: Half of the image's width and height at a depth of 1.
    """

    w2c: Float64
    half: Float64

    def weights(self, points: Float64) -> Float64:
        """Weight of each point in the image; 0 outside.

        Points in the middle weigh more than those at the edges, and near points more than those
        that they may hide, by the area that a thing of one size takes in the image.

        Args:
            points: World units [n, 3].
        """
        x, y, z = self.w2c[:, :3] @ points.T + self.w2c[:, 3:]
        ahead = z > 0
        depth = np.where(ahead, z, 1.0)
        u, v = x / depth / self.half[0], y / depth / self.half[1]
        seen = ahead & (np.abs(u) <= 1) & (np.abs(v) <= 1)
        return np.where(seen, np.exp(-MIDDLE * (u * u + v * v) * seen) / (depth * depth), 0.0)


def parse_first(text: str) -> FirstView | None:
    """The view in a file's note; None if it is not of the form of docs/format.md."""
    try:
        values = json.loads(text)
        w2c = np.array(values["w2c"], np.float64).reshape(3, 4)
        half = np.array(values["half"], np.float64).reshape(2)
    except (AttributeError, ValueError, LookupError, TypeError, OverflowError, RecursionError):
        return None
    sound = (np.abs([*w2c.ravel(), *half]) <= FAR).all() and (half > 0).all()
    return FirstView(w2c, half) if sound else None
