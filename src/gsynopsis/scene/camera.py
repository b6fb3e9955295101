"""A pinhole camera and the rules for scaling it."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Shift = tuple[float, float]
"""Offset of an image's pixels, right and down, in pixels."""
STILL: Shift = (0.0, 0.0)
AHEAD = 1e-9
"""A point counts as before a camera beyond this depth, world units: a pixel is divided by it."""


class FramedPoints(NamedTuple):
    """Those of P points that a camera has in frame.

    Attributes:
        which: Mask of the points in frame, bool [P].
        columns: Columns of their pixels, int64 [n].
        rows: Rows of their pixels, int64 [n].
        depths: Along the camera's z, world units, float64 [n].
    """

    which: NDArray[np.bool_]
    columns: NDArray[np.int64]
    rows: NDArray[np.int64]
    depths: NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """A pinhole camera: OpenCV axes (x right, y down, z forward), pixel centres at +0.5.

    A world point p is at camera point `w2c[:3, :3] @ p + w2c[:3, 3]` and at the pixel
    `(fx * x / z + cx, fy * y / z + cy)`, where (0, 0) is the corner of the first pixel.

    Attributes:
        width: Image width, pixels.
        height: Image height, pixels.
        fx: Focal length along x, pixels.
        fy: Focal length along y, pixels.
        cx: Principal point, pixels from the left edge.
        cy: Principal point, pixels from the top edge.
        w2c: World to camera, float64 [4, 4], rotation and translation only.

    Examples:
        >>> import numpy as np
        >>> camera = gs.Camera(96, 64, fx=80.0, fy=80.0, cx=48.0, cy=32.0, w2c=np.eye(4))
        >>> camera.scaled(2).width, camera.forward.tolist()
        (48, [0.0, 0.0, 1.0])
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    w2c: NDArray[np.float64]  # [4, 4]

    @property
    def position(self) -> NDArray[np.float64]:
        """The camera centre in world units, float64 [3]."""
        rotation, translation = self.w2c[:3, :3], self.w2c[:3, 3]
        return -rotation.T @ translation

    @property
    def focal_length(self) -> float:
        """Focal length in pixels, one for both axes: their geometric mean."""
        return math.sqrt(self.fx * self.fy)

    @property
    def forward(self) -> NDArray[np.float64]:
        """The viewing direction in the world, unit length, float64 [3]."""
        return self.w2c[2, :3].copy()

    def framed(self, points: NDArray[np.float64]) -> FramedPoints:
        """Those of the world points [P, 3] that lie before the camera and within its image."""
        local = points @ self.w2c[:3, :3].T + self.w2c[:3, 3]
        ahead = local[:, 2] > AHEAD
        depth = np.where(ahead, local[:, 2], 1.0)
        x = self.fx * local[:, 0] / depth + self.cx
        y = self.fy * local[:, 1] / depth + self.cy
        which = ahead & (x >= 0) & (x < self.width) & (y >= 0) & (y < self.height)
        return FramedPoints(
            which, x[which].astype(np.int64), y[which].astype(np.int64), depth[which]
        )

    def resized(self, width: int, height: int) -> "Camera":
        """The same camera for an image resized to width × height pixels."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=self.cx * sx,
            cy=self.cy * sy,
        )

    def scaled(self, factor: float) -> "Camera":
        """The camera of the photo divided by `factor`, sizes rounded to whole pixels."""
        return self.resized(*scaled_size(self.width, self.height, factor))

    def within(self, side: int) -> "Camera":
        """The camera of the photo whose longer side has at most `side` pixels."""
        return self.scaled(max(1.0, max(self.width, self.height) / side))

    def shifted(self, shift: Shift) -> "Camera":
        """The same view, its pixels so far right and down of their places; -0.5 to 0.5 pixels."""
        return replace(self, cx=self.cx - shift[0], cy=self.cy - shift[1])


def positions_of(cameras: Iterable[Camera]) -> NDArray[np.float64]:
    """Centres of cameras, world units, float64 [n, 3]."""
    return np.array([camera.position for camera in cameras], np.float64).reshape(-1, 3)


def scaled_size(width: int, height: int, factor: float) -> tuple[int, int]:
    """Width and height divided by `factor`, rounded (half to even), at least one pixel."""
    return max(1, round(width / factor)), max(1, round(height / factor))


def look_at(
    eye: NDArray[np.float64], target: NDArray[np.float64], up: NDArray[np.float64]
) -> NDArray[np.float64]:
    """World to camera, float64 [4, 4]: at `eye`, looking at `target`, `up` upwards in the image.

    Args:
        eye: The camera's centre [3].
        target: A point in the middle of its picture [3].
        up: Away from the ground, not zero [3]; where it is along the view, any direction serves.
    """
    return look_from(eye[None], target, up)[0]


def look_from(
    eyes: NDArray[np.float64], targets: NDArray[np.float64], up: NDArray[np.float64]
) -> NDArray[np.float64]:
    """As `look_at` from many places [n, 3], at one target or as many, float64 [n, 4, 4]."""
    forward = unit(targets - eyes)
    right = across(np.cross(forward, up), forward)
    w2c = np.tile(np.eye(4), (len(eyes), 1, 1))
    w2c[:, :3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    w2c[:, :3, 3] = -(w2c[:, :3, :3] @ eyes[:, :, None])[:, :, 0]
    return w2c


def nearest_rotation(
    matrix: NDArray[np.float64], tolerance: float
) -> tuple[NDArray[np.float64] | None, float]:
    """The rotation nearest to a matrix, both [3, 3], and how far the matrix is from being one.

    That is the largest element of RᵀR - 1. None where it is over the tolerance, or the matrix
    mirrors.
    """
    off = float(np.abs(matrix.T @ matrix - np.eye(3)).max())
    if off > tolerance or np.linalg.det(matrix) < 0:
        return None, off
    left, _, right = np.linalg.svd(matrix)
    return left @ right, off


def world_to_camera(
    rotation: NDArray[np.float64], position: NDArray[np.float64]
) -> NDArray[np.float64]:
    """World to camera, [4, 4], of a camera to world rotation [3, 3] and the camera's place [3]."""
    w2c = np.eye(4)
    w2c[:3, :3] = rotation.T
    w2c[:3, 3] = -w2c[:3, :3] @ position
    return w2c


def unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors [..., 3] at unit length; those of no length stay."""
    return vectors / np.maximum(_length(vectors), 1e-12)


def across(vectors: NDArray[np.float64], axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """The part of each vector at right angles to its axis, both [..., 3], unit length; any if none.

    Axes are of unit length.
    """
    spare: NDArray[np.float64] = np.eye(3)[np.abs(axes).argmin(axis=-1)]
    part, other = _aside(vectors, axes), _aside(spare, axes)
    there = _length(part) > 1e-9 * np.maximum(1.0, _length(vectors))
    return unit(np.where(there, part, other))


def _aside(vectors: NDArray[np.float64], axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors without their parts along axes of unit length, both [..., 3]."""
    return vectors - (vectors * axes).sum(axis=-1, keepdims=True) * axes


def _length(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lengths of vectors [..., 3], as [..., 1]."""
    return np.linalg.norm(vectors, axis=-1, keepdims=True)
