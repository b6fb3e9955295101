"""Painted objects to furnish a synthetic world with: balls, posts, boxes and gable roofs."""

from collections.abc import Sequence

import numpy as np

from gsynopsis.synthetic.raytracer import Paint, Surface
from gsynopsis.synthetic.shapes import Convex, Cylinder, Ellipsoid, column
from gsynopsis.synthetic.textures import placed


def ball(
    center: Sequence[float],
    radii: Sequence[float],
    paint: Paint,
    gloss: float = 0.0,
    mirror: float = 0.0,
) -> Surface:
    """An ellipsoid with its bound."""
    shape = Ellipsoid(column(center), column(radii))
    bound = (center[0], center[1], center[2], max(radii) * 1.001)
    return Surface(shape, placed(paint, center), bound, gloss, mirror)


def post(
    center: Sequence[float], radius: float, height: float, paint: Paint, gloss: float = 0.0
) -> Surface:
    """A cylinder that stands on `center`, with its bound."""
    x, y, z = center[0], center[1], center[2] + height / 2
    reach = float(np.hypot(radius, height / 2)) * 1.001
    return Surface(
        Cylinder(column((x, y, z)), radius, height / 2),
        placed(paint, center),
        (x, y, z, reach),
        gloss,
    )


def block(
    center: Sequence[float], size: Sequence[float], yaw: float, paint: Paint, roof: float = 0.0
) -> Surface:
    """A box that stands on `center`, turned by `yaw` radians; `roof` > 0 makes it a gable roof.

    A gable roof has its ridge along the box's own x axis, `roof` metres over the eaves, and the
    box below the eaves is `size[2]` high.
    """
    c, s = np.cos(yaw), np.sin(yaw)
    x, y, z = np.array([c, s, 0]), np.array([-s, c, 0]), np.array([0, 0, 1])
    half, height = np.array(size) / 2, size[2]
    slope = np.hypot(roof, half[1])
    up = [(z, height)]
    if roof > 0:
        tilt, level = half[1] / slope, roof / slope
        reach = half[1] * level + height * tilt
        up = [(side * y * level + z * tilt, reach) for side in (1, -1)]
    faces = [(x, half[0]), (-x, half[0]), (y, half[1]), (-y, half[1]), (-z, 0.0), *up]
    normals = np.array([face[0] for face in faces])
    offsets = np.array([face[1] for face in faces]) + normals @ np.array(center)
    shape = Convex(normals.astype(np.float32), offsets.astype(np.float32)[:, None])
    tall = height + roof
    reach = float(np.sqrt(half[0] ** 2 + half[1] ** 2 + (tall / 2) ** 2)) * 1.001
    bound = (center[0], center[1], center[2] + tall / 2, reach)
    return Surface(shape, placed(paint, center, yaw), bound)
