"""Lenses with distortion: COLMAP's camera models, and the pinhole camera that replaces one.

A point of the pinhole image plane, (x/z, y/z), is distorted as OpenCV and COLMAP do it; photos are
resampled so that training sees pinhole cameras only.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import SceneError

Points = NDArray[np.float64]
"""Places in a plane, float64 [n, 2]."""
WIDEST = float(np.tan(np.radians(60.0)))
"""Half of the widest part kept of a fisheye image, as a slope: 120 degrees across."""
LARGEST_GROWTH = 2.0
"""Most widths and heights of the photo that a pinhole image may have."""
STEPS = 30
"""Most iterations of Newton's method."""
CLOSE = 1e-9
"""Step at which it ends, focal lengths."""
GRID = 64
"""Places along each side at which a lens is tested for folding."""


@dataclass(frozen=True)
class Lens:
    """Distortion of the image plane by a lens; all zero: none.

    Attributes:
        fisheye: Distances from the axis are angles.
        radial: Factors of r², r⁴, r⁶, r⁸.
        divisor: The same below the fraction, r², r⁴, r⁶.
        tangential: p1, p2.
        prism: Factors of r² along x and along y.
        field: ω of the FOV model, radians; 0: none.
    """

    fisheye: bool = False
    radial: tuple[float, ...] = ()
    divisor: tuple[float, ...] = ()
    tangential: tuple[float, float] = (0.0, 0.0)
    prism: tuple[float, float] = (0.0, 0.0)
    field: float = 0.0

    @property
    def straight(self) -> bool:
        """True if it distorts nothing."""
        numbers = (*self.radial, *self.divisor, *self.tangential, *self.prism, self.field)
        return not self.fisheye and not any(numbers)

    def distorted(self, plane: Points) -> Points:
        """Distorted places of points of the image plane [n, 2]."""
        if self.fisheye:
            distance = np.linalg.norm(plane, axis=1, keepdims=True)
            plane = plane * _ratio(np.arctan(distance), distance)
        x, y = plane[:, 0], plane[:, 1]
        r2 = x * x + y * y
        if self.field:
            r = np.sqrt(r2)[:, None]
            wide = 2 * np.tan(self.field / 2)
            return plane * _ratio(np.arctan(wide * r) / self.field, r, wide / self.field)
        factor = _polynomial(self.radial, r2) / _polynomial(self.divisor, r2)
        (p1, p2), (s1, s2) = self.tangential, self.prism
        u = x * factor + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + s1 * r2
        v = y * factor + 2 * p2 * x * y + p1 * (r2 + 2 * y * y) + s2 * r2
        return np.stack([u, v], axis=1)

    def undistorted(self, bent: Points) -> tuple[Points, NDArray[np.bool_]]:
        """The inverse by Newton's method from the axis outwards, and where it exists.

        Args:
            bent: Distorted places, [n, 2].
        """
        plane = np.zeros_like(bent)
        with np.errstate(all="ignore"):
            for share in (0.25, 0.5, 0.75, 1.0):
                for _ in range(STEPS):
                    off = share * bent - self.distorted(plane)
                    if float(np.nanmax(np.abs(off), initial=0.0)) < CLOSE:
                        break
                    plane = plane + _solved(self.jacobian(plane), off)
            good = np.abs(bent - self.distorted(plane)).max(axis=1) < 1e-6
            good &= _determinant(self.jacobian(plane)) > 0
        return plane, good

    def jacobian(self, plane: Points) -> NDArray[np.float64]:
        """Derivatives of `distorted`, [n, 2, 2], by central differences."""
        step = 1e-6
        columns = [
            (self.distorted(plane + step * axis) - self.distorted(plane - step * axis)) / (2 * step)
            for axis in np.eye(2)
        ]
        return np.stack(columns, axis=2)


STRAIGHT = Lens()
"""A pinhole camera's."""


@dataclass(frozen=True)
class Warp:
    """Resampling of a photo with distortion as a pinhole image.

    Attributes:
        lens: Distorts the plane.
        photo: Width, height, fx, fy, cx, cy of the photo, pixels.
        pinhole: The same of the pinhole image.
    """

    lens: Lens
    photo: tuple[int, int, float, float, float, float]
    pinhole: tuple[int, int, float, float, float, float]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the photo, pixels."""
        return self.photo[:2]

    def source(self, places: Points) -> Points:
        """Places in the photo of pixels of the pinhole image, corners at (0, 0), [n, 2]."""
        _, _, fx, fy, cx, cy = self.pinhole
        bent = self.lens.distorted((places - (cx, cy)) / (fx, fy))
        _, _, fx, fy, cx, cy = self.photo
        return bent * (fx, fy) + (cx, cy)


def lens_of(model: str, params: Sequence[float]) -> tuple[tuple[float, ...], Lens]:
    """Focal lengths and principal point (fx, fy, cx, cy), and the lens, of a COLMAP camera.

    Args:
        model: One of `PARAMS`.
        params: The model's parameters, in COLMAP's order.
    """
    p = tuple(float(value) for value in params)
    if model in SINGLE_FOCAL:
        intrinsics, rest = (p[0], p[0], p[1], p[2]), p[3:]
    else:
        intrinsics, rest = p[:4], p[4:]
    return intrinsics, LENSES[model](rest)


def _radial(k: tuple[float, ...]) -> Lens:
    return Lens(radial=k)


def _fisheye(k: tuple[float, ...]) -> Lens:
    return Lens(fisheye=True, radial=k)


def _opencv(k: tuple[float, ...]) -> Lens:
    return Lens(radial=k[:2], tangential=(k[2], k[3]))


def _full(k: tuple[float, ...]) -> Lens:
    return Lens(radial=(k[0], k[1], k[4]), divisor=k[5:8], tangential=(k[2], k[3]))


def _prism(k: tuple[float, ...]) -> Lens:
    radial = (k[0], k[1], k[4], k[5])
    return Lens(True, radial, tangential=(k[2], k[3]), prism=(k[6], k[7]))


LENSES: dict[str, Callable[[tuple[float, ...]], Lens]] = {
    "SIMPLE_PINHOLE": _radial,
    "PINHOLE": _radial,
    "SIMPLE_RADIAL": _radial,
    "RADIAL": _radial,
    "OPENCV": _opencv,
    "OPENCV_FISHEYE": _fisheye,
    "FULL_OPENCV": _full,
    "FOV": lambda k: Lens(field=k[0]),
    "SIMPLE_RADIAL_FISHEYE": _fisheye,
    "RADIAL_FISHEYE": _fisheye,
    "THIN_PRISM_FISHEYE": _prism,
}
"""Lens from the parameters after the principal point, by COLMAP's model name."""
SINGLE_FOCAL = {
    *("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"),
}
"""The models with one focal length."""
PARAMS = {
    "SIMPLE_PINHOLE": 3,
    "PINHOLE": 4,
    "SIMPLE_RADIAL": 4,
    "RADIAL": 5,
    "OPENCV": 8,
    "OPENCV_FISHEYE": 8,
    "FULL_OPENCV": 12,
    "FOV": 5,
    "SIMPLE_RADIAL_FISHEYE": 4,
    "RADIAL_FISHEYE": 5,
    "THIN_PRISM_FISHEYE": 12,
}
"""Number of parameters of each model."""


@lru_cache(maxsize=256)
def warp_of(
    path: Path,
    field: str,
    lens: Lens,
    size: tuple[int, int],
    intrinsics: tuple[float, ...],
) -> Warp | None:
    """The pinhole image that a photo becomes; None where the lens is straight already.

    It keeps the focal lengths and is the largest rectangle that the photo fills wholly, but no
    wider than 120 degrees and twice the photo.

    Args:
        path: The file that the lens comes from, for messages.
        field: The camera in it, for messages.
        lens: Bends the plane.
        size: Width and height of the photo, pixels.
        intrinsics: fx, fy, cx, cy of the photo, pixels.

    Raises:
        SceneError: The lens folds over within the photo.
    """
    if lens.straight:
        return None
    (width, height), (fx, fy, cx, cy) = size, intrinsics
    low, high = _inner_box(lens, size, intrinsics)
    sides = [(LARGEST_GROWTH * s / f) / 2 for s, f in ((width, fx), (height, fy))]
    low = np.maximum(low, np.negative(np.minimum(sides, WIDEST)))
    high = np.minimum(high, np.minimum(sides, WIDEST))
    grid = np.stack(np.meshgrid(*np.linspace(low, high, GRID).T), axis=-1).reshape(-1, 2)
    pixels = np.floor((high - low) * (fx, fy) + 1e-6)
    if not (np.isfinite(pixels).all() and pixels.min() >= 1 and _one_to_one(lens, grid)):
        raise SceneError(
            path,
            f"{field} distortion",
            found="a lens that folds over within the photo",
            expected="one that is one-to-one",
            advice="estimate poses again with fewer parameters: gsynopsis scene PHOTOS OUT "
            "--lens SIMPLE_RADIAL",
        )
    left, top = -low[0] * fx, -low[1] * fy
    pinhole = (int(pixels[0]), int(pixels[1]), fx, fy, float(left), float(top))
    return Warp(lens, (width, height, fx, fy, cx, cy), pinhole)


def _one_to_one(lens: Lens, grid: Points) -> bool:
    with np.errstate(all="ignore"):
        return bool((_determinant(lens.jacobian(grid)) > 0).all())


def _inner_box(
    lens: Lens, size: tuple[int, int], intrinsics: tuple[float, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lowest and highest (x, y) of a rectangle of the plane that lies within the photo."""
    (width, height), (fx, fy, cx, cy) = size, intrinsics
    along = np.linspace(0.0, 1.0, GRID)
    sides: list[float] = []
    for axis, place in ((0, 0), (1, 0), (0, width), (1, height)):
        border = np.empty((GRID, 2))
        border[:, axis], border[:, 1 - axis] = place, along * (height if axis == 0 else width)
        plane, good = lens.undistorted((border - (cx, cy)) / (fx, fy))
        # What the photo's edge shows beyond the lens's reach is farther out than any that it has.
        values = np.where(good, plane[:, axis], np.inf if place else -np.inf)
        sides.append(float(values.min() if place else values.max()))
    return np.array(sides[:2]), np.array(sides[2:])


def _polynomial(factors: tuple[float, ...], r2: NDArray[np.float64]) -> NDArray[np.float64]:
    """The sum 1 + k1 r² + k2 r⁴ and so on."""
    total = np.zeros_like(r2)
    for factor in reversed(factors):
        total += factor
        total *= r2
    return 1 + total


def _ratio(
    top: NDArray[np.float64], bottom: NDArray[np.float64], limit: float = 1.0
) -> NDArray[np.float64]:
    """The quotient, or its limit where both are zero."""
    small = bottom < 1e-12
    return np.where(small, limit, top / np.where(small, 1.0, bottom))


def _determinant(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    m = matrices
    return m[:, 0, 0] * m[:, 1, 1] - m[:, 0, 1] * m[:, 1, 0]


def _solved(matrices: NDArray[np.float64], right: Points) -> Points:
    """Solutions of 2 × 2 systems; zero where there is none."""
    m, d = matrices, _determinant(matrices)
    d = np.where(np.abs(d) < 1e-12, np.inf, d)
    x = (m[:, 1, 1] * right[:, 0] - m[:, 0, 1] * right[:, 1]) / d
    y = (m[:, 0, 0] * right[:, 1] - m[:, 1, 0] * right[:, 0]) / d
    return np.stack([x, y], axis=1)
