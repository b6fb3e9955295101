"""Up of a world, and Gaussians turned from one world into another.

A file keeps the axes of its input and says which way is up. Formats have axes of their own: those
of 3DGS, y down, in PLY and SOG; y up in SPZ, glTF and USD. Writers take Gaussians with y down.
"""

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gsynopsis.records import SH_0, SH_1, SH_2, SH_3, PlainGaussians

Up = tuple[float, float, float]
Float64 = NDArray[np.float64]
DOWN: Up = (0.0, -1.0, 0.0)
"""Up in files that keep COLMAP's axes, as those of 3DGS do."""
UP: Up = (0.0, 1.0, 0.0)

AXIS = re.compile(r"([+-]?)\s*([xyz])(?:[\s_-]*up)?", re.IGNORECASE)
BRACKETS = str.maketrans("[](){},;", " " * 8)
SHORTEST, LONGEST = 1e-6, 1e6
"""Range of the length of a direction vector."""


def parse_up(text: str) -> Up | None:
    """A direction of unit length, written as `z`, `+Z`, `-y`, `0 0 1` or `[0, 0, 1]`; else None."""
    if axis := AXIS.fullmatch(text.strip()):
        place = "xyz".index(axis[2].lower())
        return unit([(-1.0 if axis[1] == "-" else 1.0) * (k == place) for k in range(3)])
    try:
        return unit([float(word) for word in text.translate(BRACKETS).split()])
    except ValueError:
        return None


def unit(values: Sequence[float]) -> Up | None:
    """Three numbers made one long; None if that cannot be."""
    length = float(np.linalg.norm(values)) if len(values) == 3 else 0.0
    if not SHORTEST < length < LONGEST:
        return None
    x, y, z = (value / length + 0.0 for value in values)
    return x, y, z


def up_text(up: Up) -> str:
    """A direction as notes and messages have it."""
    return " ".join(f"{value + 0.0:.6g}" for value in up)


def nearest_axis(up: Up) -> Up:
    """The axis, with its sign, that a direction is nearest to."""
    place = int(np.abs(up).argmax())
    x, y, z = (float(np.sign(up[k])) * (k == place) + 0.0 for k in range(3))
    return x, y, z


def turn_between(up: Up, target: Up) -> Float64:
    """A rotation, quaternion w x y z [4], that takes one unit vector to another.

    First the nearest axis goes there, a quarter or half turn, then the rest by the shortest way: so
    a little noise in `up` turns nothing about it.
    """
    coarse = _shortest(np.array(nearest_axis(up)), np.array(target))
    return _product(_shortest(matrix_of(coarse) @ np.array(up), np.array(target)), coarse)


def turned(gaussians: PlainGaussians, turn: Float64) -> PlainGaussians:
    """The same Gaussians in a world that is turned, colours included.

    Args:
        gaussians: Any number.
        turn: Quaternion w x y z of unit length [4].
    """
    if np.array_equal(np.abs(turn), [1, 0, 0, 0]):
        return gaussians
    g, matrix = gaussians, matrix_of(turn)
    w, x, y, z = turn
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    harmonics = _harmonics_turned(matrix, g.sh.shape[1]).astype(np.float32)
    return replace(
        g,
        means=(g.means.astype(np.float64) @ matrix.T).astype(np.float32),
        quaternions=(g.quaternions.astype(np.float64) @ left.T).astype(np.float32),
        sh=np.einsum("ab,gbc->gac", harmonics, g.sh),
    )


def half_turned(gaussians: PlainGaussians) -> PlainGaussians:
    """The same Gaussians after half a turn about x: from y down and z ahead to y up and z back."""
    return turned(gaussians, np.array([0.0, 1.0, 0.0, 0.0]))


def mirrored(gaussians: PlainGaussians) -> PlainGaussians:
    """The same Gaussians in a world whose z axis points the other way: in a mirror."""
    g, signs = gaussians, np.diag([1.0, 1.0, -1.0])
    harmonics = _harmonics_turned(signs, g.sh.shape[1]).astype(np.float32)
    return replace(
        g,
        means=g.means * np.array([1, 1, -1], np.float32),
        quaternions=g.quaternions * np.array([1, -1, -1, 1], np.float32),
        sh=np.einsum("ab,gbc->gac", harmonics, g.sh),
    )


def harmonic_values(d: Float64, count: int) -> Float64:
    """The first `count` spherical harmonics of 3DGS at unit directions [V, 3], [V, count]."""
    x, y, z = d.T
    xx, yy, zz = x * x, y * y, z * z
    a, b, c = SH_2
    e, f, g, h, i = SH_3
    found = [
        np.full_like(x, SH_0),
        *(-SH_1 * y, SH_1 * z, -SH_1 * x),
        *(a * x * y, -a * y * z, b * (2 * zz - xx - yy), -a * x * z, c * (xx - yy)),
        *(-e * y * (3 * xx - yy), f * x * y * z, -g * y * (4 * zz - xx - yy)),
        h * z * (2 * zz - 3 * xx - 3 * yy),
        *(-g * x * (4 * zz - xx - yy), i * z * (xx - yy), -e * x * (xx - 3 * yy)),
    ]
    return np.stack(found[:count], axis=1)


def _harmonics_turned(matrix: Float64, count: int) -> Float64:
    """The matrix of coefficients [count, count] of a turn: solved at directions of all sides."""
    d = np.random.default_rng(0).standard_normal((4 * count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    before, after = harmonic_values(d @ matrix, count), harmonic_values(d, count)
    solved: Float64 = np.linalg.lstsq(after, before, rcond=None)[0].astype(np.float64)
    return np.round(solved, 12) + 0.0


def _shortest(start: Float64, end: Float64) -> Float64:
    """The shortest rotation between directions; about x or, of x itself, z if they are opposite."""
    if float(start @ end) < -1 + 1e-9:
        return np.array([0.0, 1.0, 0.0, 0.0] if abs(start[0]) < 0.5 else [0.0, 0.0, 0.0, 1.0])
    found: Float64 = np.array([1 + start @ end, *np.cross(start, end)], np.float64)
    found /= np.linalg.norm(found)
    return found


def _product(a: Float64, b: Float64) -> Float64:
    across = np.cross(a[1:], b[1:])
    return np.array([a[0] * b[0] - a[1:] @ b[1:], *(a[0] * b[1:] + b[0] * a[1:] + across)])


def matrix_of(q: Float64) -> Float64:
    """The rotation [3, 3] of a quaternion w x y z of unit length [4]."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_of(matrix: Float64) -> Float64:
    """The quaternion w x y z of unit length [4] of a rotation [3, 3]: its own vector of value 1."""
    m = matrix
    skew = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    form = np.empty((4, 4))
    form[0, 0] = np.trace(m)
    form[0, 1:] = form[1:, 0] = skew
    form[1:, 1:] = m + m.T - np.trace(m) * np.eye(3)
    # The largest eigenvalue of this symmetric form is 3, and its vector the quaternion.
    return np.linalg.eigh(form)[1][:, -1]
