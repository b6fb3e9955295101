"""The shapes that rays of the synthetic scenes can meet.

Vectors are float32 [3, n], one column a ray, so that each component is contiguous.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating]
"""Float32 in fact; wider in type because the stubs of NumPy widen what arithmetic returns."""
NEAR = np.float32(1e-3)
"""World units; a hit nearer than this is the surface that the ray leaves."""
ONE_THREAD = 1 << 18
"""Multiplications up to which OpenBLAS keeps a product of matrices on the thread that asks."""


class Shape(Protocol):
    """A surface that rays can meet."""

    def hit(self, origin: Floats, direction: Floats) -> Floats:
        """Distance [n] along each ray [3, n] to the first hit beyond `NEAR`, inf if none."""
        ...

    def normal(self, position: Floats) -> Floats:
        """Unit normals [3, n] at points [3, n] of the surface."""
        ...


def column(values: Sequence[float]) -> Floats:
    """Three numbers as a float32 [3, 1] vector."""
    return np.array(values, np.float32).reshape(3, 1)


def dot(a: Floats, b: Floats) -> Floats:
    """Dot products [n] of columns."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def product(matrix: Floats, columns: Floats) -> Floats:
    """`matrix @ columns`, [m, 3] by [3, n], in parts that OpenBLAS keeps on this thread.

    A second thread has nothing to win on so small a product. It waits for the next one at full
    load, and takes its core from the thread that computes another photo.
    """
    out = np.empty((len(matrix), columns.shape[1]), np.result_type(matrix, columns))
    step = ONE_THREAD // matrix.size
    for start in range(0, columns.shape[1], step):
        block = slice(start, start + step)
        np.matmul(matrix, columns[:, block], out=out[:, block])
    return out


def unit(a: Floats) -> Floats:
    """Columns brought to unit length."""
    return a / np.sqrt(dot(a, a))


def _interval(enter: Floats, leave: Floats) -> Floats:
    """The entry of an interval of the ray that is not empty and begins in front of it."""
    return np.where((enter <= leave) & (enter > NEAR), enter, np.float32(np.inf))


@dataclass(frozen=True)
class Plane:
    """The points p with normal · p = offset, seen from the side the normal points to."""

    direction: Floats  # [3, 1] unit length
    offset: float

    def hit(self, origin: Floats, direction: Floats) -> Floats:
        """See `Shape.hit`."""
        speed = dot(self.direction, direction)
        height = dot(self.direction, origin) - np.float32(self.offset)
        t = height / np.where(speed < 0, -speed, np.float32(1))
        return np.where((speed < 0) & (t > NEAR), t, np.float32(np.inf))

    def normal(self, position: Floats) -> Floats:
        """See `Shape.normal`."""
        return np.broadcast_to(self.direction, position.shape)


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid along the axes; `inside` shows its inner wall, as a dome does."""

    center: Floats  # [3, 1]
    radii: Floats  # [3, 1]
    inside: bool = False

    def hit(self, origin: Floats, direction: Floats) -> Floats:
        """See `Shape.hit`."""
        start, step = (origin - self.center) / self.radii, direction / self.radii
        a, b, c = dot(step, step), dot(start, step), dot(start, start) - np.float32(1)
        square = b * b - a * c
        root = np.sqrt(np.maximum(square, 0))
        t = ((root if self.inside else -root) - b) / a
        return np.where((square > 0) & (t > NEAR), t, np.float32(np.inf))

    def normal(self, position: Floats) -> Floats:
        """See `Shape.normal`."""
        outward = unit((position - self.center) / (self.radii * self.radii))
        return -outward if self.inside else outward


@dataclass(frozen=True)
class Cylinder:
    """A capped cylinder along z."""

    center: Floats  # [3, 1]
    radius: float
    half: float

    def hit(self, origin: Floats, direction: Floats) -> Floats:
        """See `Shape.hit`."""
        o = origin - self.center
        dx, dy, dz = direction
        a = np.maximum(dx * dx + dy * dy, np.float32(1e-12))
        b = o[0] * dx + o[1] * dy
        c = o[0] * o[0] + o[1] * o[1] - np.float32(self.radius**2)
        square = b * b - a * c
        root = np.sqrt(np.maximum(square, 0))
        dz = np.where(np.abs(dz) < 1e-9, np.float32(1e-9), dz)
        low, high = (-self.half - o[2]) / dz, (self.half - o[2]) / dz
        enter = np.maximum((-b - root) / a, np.minimum(low, high))
        leave = np.minimum((root - b) / a, np.maximum(low, high))
        return np.where(square > 0, _interval(enter, leave), np.float32(np.inf))

    def normal(self, position: Floats) -> Floats:
        """See `Shape.normal`."""
        p = position - self.center
        around = np.sqrt(p[0] * p[0] + p[1] * p[1])
        cap = self.half - np.abs(p[2]) < np.abs(self.radius - around)
        flat, side = np.zeros_like(p), p / np.maximum(around, np.float32(1e-9))
        flat[2], side[2] = np.sign(p[2]), 0
        return np.where(cap, flat, side)


@dataclass(frozen=True)
class Convex:
    """A convex polyhedron: the points p with normals · p ≤ offsets."""

    normals: Floats  # [m, 3] unit length, outward
    offsets: Floats  # [m, 1]

    def hit(self, origin: Floats, direction: Floats) -> Floats:
        """See `Shape.hit`."""
        speed = product(self.normals, direction)
        speed[np.abs(speed) < 1e-9] = 1e-9
        t = (self.offsets - product(self.normals, origin)) / speed
        enter = np.where(speed < 0, t, np.float32(-np.inf)).max(axis=0)
        return _interval(enter, np.where(speed > 0, t, np.float32(np.inf)).min(axis=0))

    def normal(self, position: Floats) -> Floats:
        """See `Shape.normal`."""
        face = (product(self.normals, position) - self.offsets).argmax(axis=0)
        return self.normals[face].T


@dataclass(frozen=True)
class Ridge:
    """The inner wall of a cylinder around the z axis, cut off along a skyline.

    Attributes:
        radius: Distance of the wall from the axis, world units.
        skyline: Height over z = 0 for an azimuth in radians, [n] → [n].
    """

    radius: float
    skyline: Callable[[Floats], Floats]

    def hit(self, origin: Floats, direction: Floats) -> Floats:
        """See `Shape.hit`."""
        dx, dy, dz = direction
        a = np.maximum(dx * dx + dy * dy, np.float32(1e-12))
        b = origin[0] * dx + origin[1] * dy
        c = origin[0] ** 2 + origin[1] ** 2 - np.float32(self.radius**2)
        t = (np.sqrt(np.maximum(b * b - a * c, 0)) - b) / a
        height = origin[2] + t * dz
        azimuth = np.arctan2(origin[1] + t * dy, origin[0] + t * dx)
        return np.where((height < self.skyline(azimuth)) & (t > NEAR), t, np.float32(np.inf))

    def normal(self, position: Floats) -> Floats:
        """See `Shape.normal`."""
        inward = -position / np.float32(self.radius)
        inward[2] = 0
        return inward
