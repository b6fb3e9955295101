"""Panoramas of the whole sphere cut into perspective views that cover it.

An equirectangular photo has longitude across, latitude down, and what its camera looks at in the
middle, as COLMAP's and nerfstudio's EQUIRECTANGULAR have it.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gsynopsis.scene.resample import resample

VIEWS = 8
"""Views of a panorama: six around, 60 degrees apart, then up and down."""
ANGLE = np.radians(95.0)
"""Across and down of a view: so neighbours overlap, and no direction is left out."""
SMALLEST = 16
"""Least side of a view, pixels."""
Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class Cut:
    """A perspective view of a panorama; beside `Warp`, which is of a lens.

    Attributes:
        photo: Width and height of the panorama, pixels.
        pinhole: Width, height, fx, fy, cx, cy of the view, pixels.
        turn: Rows of the rotation from the panorama's camera to the view's [9].
    """

    photo: tuple[int, int]
    pinhole: tuple[int, int, float, float, float, float]
    turn: tuple[float, ...]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the photo, pixels."""
        return self.photo

    @property
    def rotation(self) -> Float64:
        """From the panorama's camera to the view's [3, 3]."""
        return np.array(self.turn).reshape(3, 3)

    def source(self, places: Float64) -> Float64:
        """Places in the panorama of pixels of the view, corners at (0, 0), [n, 2]."""
        _, _, fx, fy, cx, cy = self.pinhole
        rays = np.stack(
            [(places[:, 0] - cx) / fx, (places[:, 1] - cy) / fy, np.ones(len(places))], axis=1
        )
        x, y, z = (rays @ self.rotation).T
        width, height = self.photo
        across = (np.arctan2(x, z) / (2 * np.pi) + 0.5) * width
        down = (np.arctan2(y, np.hypot(x, z)) / np.pi + 0.5) * height
        return np.stack([across, down], axis=1).astype(np.float64)


@lru_cache(maxsize=16)
def cuts_of(size: tuple[int, int], like: tuple[int, int] | None = None) -> tuple[Cut, ...]:
    """The views of a panorama: six around from its middle to the right, up, down.

    Args:
        size: Width and height of the panorama, pixels.
        like: Size of another panorama whose views have the size that these shall have.
    """
    # As many pixels for an angle as the panorama has at its equator.
    width = (like or size)[0]
    side = max(SMALLEST, round(width / np.pi * np.tan(ANGLE / 2)))
    focal = float(side / 2 / np.tan(ANGLE / 2))
    pinhole = (side, side, focal, focal, side / 2, side / 2)
    looks = [(60.0 * step, 0.0) for step in range(6)] + [(0.0, 90.0), (0.0, -90.0)]
    return tuple(Cut(size, pinhole, tuple(_turn(*look).reshape(-1).tolist())) for look in looks)


def _turn(yaw: float, pitch: float) -> Float64:
    """To a view that looks so many degrees to the right and up."""
    (cy, cp), (sy, sp) = (f(np.radians([yaw, pitch])) for f in (np.cos, np.sin))
    ahead = np.array([sy * cp, -sp, cy * cp])
    right = np.array([cy, 0.0, -sy])
    rows = np.stack([right, np.cross(ahead, right), ahead]).astype(np.float64)
    return np.round(rows, 15) + 0.0


def cut_view(pixels: NDArray[np.uint8], cut: Cut) -> NDArray[np.uint8]:
    """The view of a panorama, both uint8 [H, W, 3], by cubic convolution."""
    width = pixels.shape[1]
    # Two more pixels at each side: across the seam, and beyond the poles the other half's.
    over = np.roll(pixels, width // 2, axis=1)
    tall = np.concatenate([over[1::-1], pixels, over[:-3:-1]])
    whole = np.concatenate([tall[:, -2:], tall, tall[:, :2]], axis=1)
    return resample(whole, cut.pinhole[:2], lambda places: cut.source(places) + 2)
