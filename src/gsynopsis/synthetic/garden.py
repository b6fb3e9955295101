"""The synthetic garden in front of far hills. z is up, units metres."""

from collections.abc import Sequence

import numpy as np

from gsynopsis.synthetic.objects import ball, block, post
from gsynopsis.synthetic.raytracer import Paint, RayScene, Spot, Surface, decode_srgb, sunlight
from gsynopsis.synthetic.shapes import Ellipsoid, Floats, Plane, Ridge, column
from gsynopsis.synthetic.textures import (
    FLAT,
    UPRIGHT,
    cells,
    checker,
    disc,
    facing,
    from_all_sides,
    mottled,
    over,
    plain,
    rectangle,
    shaded,
    sky,
    stripes,
    waves,
)

ORBIT = 3.0
"""Radius of the ring of cameras, metres."""


def world(seed: int) -> RayScene:
    """A cottage garden; trees to 16 m, hills at 32, 45 and 62 orbit radii, a sky at 110."""
    surfaces = (*_horizon(seed), *_garden(seed + 20), *_trees(seed + 40))
    lights = sunlight((0.55, -0.45, 0.72), 0.015)
    ambient = from_all_sides(decode_srgb("#8a8a5c") * 0.35, decode_srgb("#a9c8ee") * 0.62)
    return RayScene(surfaces, lights, True, decode_srgb("#fff0d2") * 1.0, ambient)


def _horizon(seed: int) -> list[Surface]:
    grass = mottled(("#3f5d23", "#5f8032", "#8aa347", "#b5b566"), waves(seed, 6.0, 0.15), 1.0)
    grass = shaded(grass, waves(seed + 1, 60.0, 8.0), 0.3)
    slabs = cells(seed + 2, ("#9a938a", "#b5aea2", "#857d73"), (0.5, 0.36), FLAT, 0.02)
    slabs = shaded(slabs, waves(seed + 3, 0.5, 0.07), 0.25)
    ground = over(grass, slabs, disc(1.95))
    ground = over(ground, slabs, rectangle((0, 1), (0, -6), (0.5, 6)))
    radius = ORBIT
    hills = [
        (32, 7.0, 4.0, ("#2c4a22", "#3f6630", "#6f8a45", "#8f9a55"), 0.12),
        (45, 17.0, 6.0, ("#35533a", "#4d7048", "#7d8a5a"), 0.4),
        (62, 36.0, 14.0, ("#4b5563", "#6d7684", "#9aa0a8", "#e8ecf2"), 0.5),
    ]
    ridges = [
        _ridge(seed + 10 + number, radius * far, (base, swing), colors, haze)
        for number, (far, base, swing, colors, haze) in enumerate(hills)
    ]
    size = 110 * radius
    dome = Ellipsoid(column((0, 0, 0)), column((size, size, size)), inside=True)
    return [
        Surface(Plane(column((0, 0, 1)), 0), ground),
        *ridges,
        Surface(dome, sky(seed + 5, size), glows=True),
    ]


def _ridge(
    seed: int, radius: float, rise: tuple[float, float], colors: Sequence[str], haze: float
) -> Surface:
    """Hills at `radius` metres, of a mean height and a swing in metres, paler with haze."""
    rng = np.random.default_rng(seed)
    turns = np.arange(2, 15)
    phase = rng.uniform(0, 2 * np.pi, len(turns))
    weight = rng.uniform(0.5, 1, len(turns)) / turns**0.8
    base, swing = rise

    def skyline(azimuth: Floats) -> Floats:
        total = np.zeros_like(azimuth)
        for n, p, w in zip(turns, phase, weight, strict=True):
            total += np.float32(w) * np.sin(np.float32(n) * azimuth + np.float32(p))
        return np.float32(base) + np.float32(swing) * total

    slope = mottled(colors, waves(seed, radius / 6, radius / 100, (1, 1, 0.5)), 1.1)
    air = decode_srgb("#b4cbe4")

    def paint(spot: Spot) -> Floats:
        return slope(spot) * np.float32(0.9 * (1 - haze)) + air * np.float32(haze * 0.85)

    return Surface(Ridge(radius, skyline), paint, glows=True)


def _garden(seed: int) -> list[Surface]:
    stone = cells(seed, ("#d8cbb3", "#c7b596", "#e6dcc8", "#b8a684"), (0.26, 0.13), UPRIGHT, 0.008)
    house = _front(shaded(stone, waves(seed + 1, 0.8, 0.08), 0.15))
    tiles = cells(seed + 2, ("#a5402d", "#b9543b", "#8c3425"), (0.16, 0.11), UPRIGHT, 0.008)
    gable = stripes(plain("#5a3d28"), plain("#7d5a3c"), (0, 1, 0), 0.12)
    crate = cells(seed + 3, ("#8f6a3f", "#a67f4e"), (0.9, 0.09), UPRIGHT, 0.006)
    rock = mottled(("#4d4a46", "#7f7a72", "#b3ada1"), waves(seed + 4, 0.5, 0.06), 1.1)
    roses = mottled(("#1f4722", "#3d7a38", "#d8436b", "#ffd0dc"), waves(seed + 5, 0.22, 0.05), 0.8)
    barrel = stripes(plain("#6a4526"), plain("#9a6b3e"), (1, 0.35, 0), 0.13)
    pole = stripes(plain("#f2efe6"), plain("#c8352e"), (0, 0, 1), 0.3)
    steel = shaded(plain("#8fb2c9"), waves(seed + 6, 0.4, 0.15), 0.08)
    return [
        block((0.1, 0.45, 0), (1.5, 1.1, 0.85), 0, house),
        block(
            (0.1, 0.45, 0.85),
            (1.7, 1.32, 0.02),
            0,
            facing(shaded(tiles, waves(seed + 7, 0.5, 0.08), 0.2), gable, 0),
            0.55,
        ),
        block((0.55, 0.62, 1.0), (0.2, 0.2, 0.55), 0, stone),
        post((-0.9, -0.75, 0), 0.11, 0.5, stripes(rock, plain("#cfc8bb"), (0, 0, 1), 0.2)),
        ball((-0.9, -0.75, 0.72), (0.22, 0.22, 0.22), steel, gloss=0.9, mirror=0.5),
        block((0.95, -0.8, 0), (0.42, 0.42, 0.42), 0.4, crate),
        block(
            (0.98, -0.78, 0.42),
            (0.26, 0.26, 0.26),
            -0.2,
            checker(plain("#2a6f97"), plain("#f4f1de"), 0.065),
        ),
        post((1.25, 0.6, 0), 0.2, 0.5, barrel),
        post((-1.15, 0.35, 0), 0.035, 1.75, pole),
        ball((-1.2, 1.1, 0.25), (0.42, 0.36, 0.34), roses),
        ball((0.3, -0.55, 0.16), (0.3, 0.22, 0.22), roses),
        ball((-0.3, -1.3, 0.1), (0.26, 0.2, 0.16), rock),
        ball((1.6, -0.2, 0.1), (0.2, 0.24, 0.17), rock),
    ]


def _front(wall: Paint) -> Paint:
    """The cottage's door and windows, seen on both long sides."""
    door = rectangle((0, 2), (0, 0.28), (0.15, 0.3))
    wall = over(wall, stripes(plain("#274c3a"), plain("#3c6b53"), (1, 0, 0), 0.08), door)
    for x in (-0.45, 0.45):
        frame = rectangle((0, 2), (x, 0.5), (0.15, 0.16))
        wall = over(wall, plain("#f7f3ea"), frame)
        wall = over(wall, plain("#31475e"), rectangle((0, 2), (x, 0.5), (0.115, 0.125)))
    return wall


def _trees(seed: int) -> list[Surface]:
    rng = np.random.default_rng(seed)
    bark = mottled(("#3d2b1f", "#6b4d36", "#8a6a4d"), waves(seed, 0.6, 0.1, (1, 1, 4)), 1.0)
    greens = (
        ("#1d3b1a", "#3c6b2a", "#86a845"),
        ("#23401f", "#55802f", "#b3b84f"),
        ("#402a12", "#a4601f", "#e0a53c"),
    )
    trees: list[Surface] = []
    for number in range(11):
        angle = 2 * np.pi * (number + rng.uniform(-0.25, 0.25)) / 11
        far = rng.uniform(5.5, 16.0)
        x, y, tall = far * np.cos(angle), far * np.sin(angle), rng.uniform(1.0, 1.6)
        wide = rng.uniform(0.9, 1.4)
        leaf = mottled(greens[int(rng.integers(3))], waves(seed + number, 1.2, 0.15), 1.1)
        trees.append(post((x, y, 0), 0.16, tall + 0.3, bark))
        trees.append(ball((x, y, tall + wide * 0.75), (wide, wide, wide), leaf))
        trees.append(
            ball(
                (x + 0.3, y - 0.2, tall + wide * 1.6), (wide * 0.65, wide * 0.65, wide * 0.75), leaf
            )
        )
    return trees
