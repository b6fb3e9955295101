"""One object before a plain backdrop, as a shop takes its photos. z is up, units metres."""

import numpy as np

from gsynopsis.synthetic.objects import ball, block, post
from gsynopsis.synthetic.raytracer import RayScene, Surface, decode_srgb
from gsynopsis.synthetic.shapes import Ellipsoid, column, unit
from gsynopsis.synthetic.textures import (
    UPRIGHT,
    cells,
    checker,
    from_all_sides,
    mottled,
    plain,
    shaded,
    stripes,
    waves,
)

ORBIT = 1.4
"""Radius of the ring of cameras, metres."""
BACKDROP = 2.5
"""Radius of the backdrop, orbit radii: it has one colour, so its distance cannot be measured."""


def world(seed: int) -> RayScene:
    """A painted figure on a plinth; all around it one pale grey without a shadow."""
    size = BACKDROP * ORBIT
    dome = Ellipsoid(column((0, 0, 0)), column((size, size, size)), inside=True)
    backdrop = Surface(dome, plain("#d7d9dc"), glows=True)
    towards = ((0.5, -0.5, 0.8), (0.45, -0.5, 0.8), (0.5, -0.45, 0.8), (0.45, -0.45, 0.8))
    lights = np.stack([unit(column(one))[:, 0] for one in towards])
    ambient = from_all_sides(decode_srgb("#d7d9dc") * 0.4, decode_srgb("#f4f6fa") * 0.6)
    light = decode_srgb("#fff4e0") * 0.9
    return RayScene((*_figure(seed + 20), backdrop), lights, True, light, ambient)


def _figure(seed: int) -> list[Surface]:
    marble = mottled(("#8f8b86", "#c9c4bc", "#efece6"), waves(seed, 0.2, 0.02, (3, 1, 1)), 1.2)
    mosaic = cells(
        seed + 1, ("#1d3557", "#2a9d8f", "#e9c46a", "#e76f51"), (0.05, 0.03), UPRIGHT, 0.003
    )
    cloth = shaded(
        checker(plain("#7a1f3d"), plain("#e8d3b0"), 0.045), waves(seed + 2, 0.1, 0.02), 0.3
    )
    bands = stripes(plain("#264653"), plain("#f4a261"), (0.2, 0, 1), 0.06)
    moss = mottled(("#16361c", "#4c8a3f", "#c3d977"), waves(seed + 3, 0.12, 0.02), 1.2)
    gold = shaded(plain("#d8a03a"), waves(seed + 4, 0.1, 0.03), 0.15)
    return [
        block((0, 0, 0.4), (0.5, 0.5, 0.12), 0.3, marble),
        post((0, 0, 0.52), 0.17, 0.06, mosaic),
        ball((0, 0, 0.75), (0.17, 0.14, 0.2), cloth, gloss=0.2),
        ball((0, 0, 1.02), (0.11, 0.11, 0.12), mosaic, gloss=0.3),
        ball((0, 0, 1.18), (0.05, 0.05, 0.08), gold, gloss=0.9, mirror=0.3),
        post((0.2, 0.08, 0.52), 0.045, 0.42, bands, gloss=0.3),
        ball((0.2, 0.08, 0.98), (0.07, 0.07, 0.06), moss),
        block((-0.2, -0.08, 0.52), (0.1, 0.14, 0.2), 0.7, bands, roof=0.08),
        ball((-0.05, 0.2, 0.57), (0.06, 0.06, 0.05), moss),
    ]
