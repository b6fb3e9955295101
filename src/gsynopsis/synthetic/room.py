"""The synthetic room, furnished, with a mirror ball on its table. z is up, units metres."""

from collections.abc import Sequence

import numpy as np

from gsynopsis.synthetic.objects import ball, block, post
from gsynopsis.synthetic.raytracer import Paint, RayScene, Spot, Surface, decode_srgb
from gsynopsis.synthetic.shapes import Floats, Plane, column
from gsynopsis.synthetic.textures import (
    FLAT,
    UPRIGHT,
    cells,
    checker,
    disc,
    facing,
    mix,
    mottled,
    over,
    plain,
    rectangle,
    shaded,
    stripes,
    waves,
)

ORBIT = 2.2
"""Radius of the ring of cameras, metres."""
ROOM = (3.5, 3.0, 2.8)
"""Half length, half width and height of the room, metres."""


def world(seed: int) -> RayScene:
    """A furnished room of 7 × 6 metres with a mirror ball on the table in its middle."""
    surfaces = (*_walls(seed), *_table(seed + 20), *_furniture(seed + 40))
    lights = np.array([[x, y, 2.55] for x in (-0.45, 0.45) for y in (-0.45, 0.45)], np.float32)
    light, sky = decode_srgb("#fff1dc") * 1.05, decode_srgb("#dfe6f2") * 0.5

    def ambient(spot: Spot) -> Floats:
        # Light reaches corners from fewer sides.
        room = np.ones_like(spot.footprint)
        for axis, side in ((0, ROOM[0]), (1, ROOM[1])):
            gap = np.float32(side) - np.abs(spot.position[axis])
            room -= np.float32(0.33) * np.exp(-gap * 4) * (np.abs(spot.normal[axis]) < 0.9)
        low = np.float32(0.3) * np.exp(-spot.position[2] * 5) * (spot.normal[2] < 0.9)
        return sky * (room - low) * (1 + np.float32(0.18) * spot.normal[2])

    return RayScene(surfaces, lights, False, light, ambient)


def _walls(seed: int) -> list[Surface]:
    length, width, height = ROOM
    grain = waves(seed, 0.6, 0.07, stretch=(5, 1, 1))
    planks = shaded(
        cells(seed, ("#a9764a", "#b98a5b", "#8f6038"), (1.7, 0.24), FLAT, 0.006), grain, 0.3
    )
    rings = _rings(plain("#8c2f39"), plain("#e8d3b0"), 0.42)
    wool = waves(seed + 1, 0.5, 0.06)
    floor = over(planks, shaded(rings, wool, 0.25), disc(1.75))
    plaster = waves(seed + 2, 2.5, 0.12)
    paper = stripes(plain("#2f6f73"), plain("#6fa8a0"), (0, 1, 0), 0.42)
    bricks = cells(seed + 3, ("#a4533c", "#b86a4e", "#8d4332"), (0.42, 0.17), UPRIGHT, 0.010)
    ochre = mottled(("#c99a3b", "#e2bd68", "#efd9a0"), plaster)
    blue = checker(plain("#5874a6"), plain("#7d97c4"), 0.3, (0, 2))
    east = _pictures(
        shaded(paper, plaster, 0.15), 1, ((-1.2, 1.6, 0.5, 0.4), (0.9, 1.55, 0.4, 0.55)), seed
    )
    north = _pictures(ochre, 0, ((0.4, 1.6, 0.55, 0.4), (1.9, 1.5, 0.4, 0.5)), seed + 5)
    west = _pictures(shaded(bricks, plaster, 0.2), 1, ((0.2, 1.75, 0.6, 0.38),), seed + 9)
    south = _window(shaded(blue, plaster, 0.15), seed + 12)
    ceiling = mottled(("#d9d4c8", "#f2efe6"), waves(seed + 4, 2.0, 0.25))
    return [
        Surface(Plane(column((0, 0, 1)), 0), floor, gloss=0.05),
        Surface(Plane(column((0, 0, -1)), -height), ceiling),
        Surface(Plane(column((-1, 0, 0)), -length), east),
        Surface(Plane(column((1, 0, 0)), -length), west),
        Surface(Plane(column((0, -1, 0)), -width), north),
        Surface(Plane(column((0, 1, 0)), -width), south),
    ]


def _rings(a: Paint, b: Paint, period: float) -> Paint:
    """Rings around the z axis."""

    def paint(spot: Spot) -> Floats:
        radius = np.sqrt(spot.position[0] ** 2 + spot.position[1] ** 2)
        wave = 0.5 + 0.5 * np.sin(radius * np.float32(2 * np.pi / period))
        return mix(a(spot), b(spot), (wave - 0.5) * 3 + 0.5)

    return paint


def _pictures(
    wall: Paint, axis: int, frames: Sequence[tuple[float, float, float, float]], seed: int
) -> Paint:
    """A wall with a white skirting board and framed pictures (x, z, half width, half height)."""
    palettes = (
        ("#14213d", "#2a6f97", "#e9c46a", "#f4f1de"),
        ("#3d0c11", "#d80032", "#f78ca2", "#f9dec9"),
        ("#0b3d2e", "#3a7d44", "#b6d369", "#fdf6d8"),
    )
    for number, (x, z, wide, high) in enumerate(frames):
        art = mottled(palettes[(seed + number) % 3], waves(seed + number + 60, 0.9, 0.12), 1.3)
        frame = rectangle((axis, 2), (x, z), (wide, high))
        inner = rectangle((axis, 2), (x, z), (wide - 0.06, high - 0.06))
        wall = over(over(wall, plain("#3a2a1d"), frame), art, inner)
    return over(wall, plain("#e9e4d8"), rectangle((axis, 2), (0, 0), (9, 0.13)))


def _window(wall: Paint, seed: int) -> Paint:
    """A wall with a window on a cloudy sky."""
    sky = mottled(("#5f9bd8", "#9cc4ea", "#ffffff"), waves(seed, 1.3, 0.2, (2, 1, 1)), 1.2)
    wall = over(wall, plain("#f4f1ea"), rectangle((0, 2), (0.3, 1.55), (1.15, 0.75)))
    for x in (-0.25, 0.85):
        pane = rectangle((0, 2), (x, 1.55), (0.5, 0.66))
        wall = over(wall, lambda spot: sky(spot) * np.float32(1.6), pane)
    return over(wall, plain("#e9e4d8"), rectangle((0, 2), (0, 0), (9, 0.13)))


def _table(seed: int) -> list[Surface]:
    oak = shaded(
        mottled(("#7a4a25", "#a8703d", "#c08a52"), waves(seed, 0.5, 0.06, (4, 1, 1))),
        waves(seed + 1, 0.2, 0.05),
        0.1,
    )
    cube = checker(plain("#f2efe6"), plain("#1f3b73"), 0.07)
    vase = stripes(plain("#f4a261"), plain("#264653"), (0.3, 0, 1), 0.12)
    egg = mottled(("#5b2a86", "#9f6bc1", "#f1e3ff"), waves(seed + 2, 0.25, 0.05), 1.3)
    gold = shaded(plain("#d8a03a"), waves(seed + 3, 0.3, 0.1), 0.12)
    lemon = mottled(("#c98a00", "#f2c500", "#fbe36a"), waves(seed + 5, 0.15, 0.04), 0.9)
    top = 0.74
    return [
        post((0, 0, 0.68), 0.8, 0.06, oak, gloss=0.15),
        post((0, 0, 0.04), 0.07, 0.64, oak),
        post((0, 0, 0), 0.4, 0.04, oak),
        ball((0.02, 0.05, top + 0.27), (0.27, 0.27, 0.27), gold, gloss=0.9, mirror=0.45),
        block((-0.47, -0.18, top), (0.28, 0.28, 0.28), 0.5, cube),
        post((0.38, -0.36, top), 0.12, 0.36, vase, gloss=0.3),
        ball((0.3, 0.5, top + 0.16), (0.13, 0.13, 0.16), egg, gloss=0.4),
        ball((-0.12, -0.52, top + 0.09), (0.09, 0.09, 0.09), plain("#d1343a"), gloss=0.7),
        ball((-0.4, 0.42, top + 0.11), (0.18, 0.12, 0.11), lemon, gloss=0.25),
    ]


def _furniture(seed: int) -> list[Surface]:
    books = cells(
        seed,
        ("#b23a48", "#1d3557", "#2a9d8f", "#e9c46a", "#6d597a", "#f1faee", "#bc6c25"),
        (0.085, 0.4),
        UPRIGHT,
        0.008,
    )
    cloth = checker(plain("#6b7f5a"), plain("#8fa37c"), 0.12)
    cloth = shaded(cloth, waves(seed + 1, 0.3, 0.05), 0.2)
    wood = shaded(
        cells(seed + 2, ("#6e4426", "#7d5230"), (0.9, 0.3), UPRIGHT, 0.01),
        waves(seed + 3, 0.5, 0.06, (1, 4, 1)),
        0.35,
    )
    leaf = mottled(("#16361c", "#2f6b34", "#7fb069"), waves(seed + 4, 0.35, 0.06), 1.2)
    clay = stripes(plain("#b5603c"), plain("#d08c60"), (0, 0, 1), 0.16)
    spots = mottled(("#e76f51", "#f4e9d8"), waves(seed + 5, 0.25, 0.08), 2.5)
    return [
        block((-1.7, 2.76, 0), (1.6, 0.46, 2.0), 0, facing(wood, books, 1)),
        block((-3.05, 0.1, 0), (0.9, 2.1, 0.44), 0, cloth),
        block((-3.38, 0.1, 0.44), (0.24, 2.1, 0.45), 0, cloth),
        block((-3.05, 1.25, 0), (0.9, 0.2, 0.62), 0, cloth),
        block((-3.05, -1.05, 0), (0.9, 0.2, 0.62), 0, cloth),
        ball((-3.1, 0.75, 0.58), (0.14, 0.26, 0.2), spots),
        ball((-3.1, -0.6, 0.58), (0.14, 0.26, 0.2), spots),
        block((3.24, -1.1, 0), (0.52, 1.5, 0.85), 0, wood),
        ball((3.2, -1.5, 1.03), (0.18, 0.18, 0.18), plain("#3c78b4"), gloss=0.7, mirror=0.08),
        post((2.85, 2.3, 0), 0.27, 0.5, clay),
        ball((2.85, 2.3, 1.0), (0.42, 0.42, 0.55), leaf),
        ball((2.6, 2.4, 1.45), (0.28, 0.28, 0.33), leaf),
        block((1.1, 2.66, 0), (1.3, 0.5, 0.5), 0, wood),
        block(
            (0.8, 2.66, 0.5),
            (0.3, 0.3, 0.3),
            0.4,
            checker(plain("#e63946"), plain("#f1faee"), 0.075),
        ),
        block((-2.4, -2.5, 0), (0.7, 0.7, 0.55), 0.3, spots),
    ]
