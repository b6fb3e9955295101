"""The synthetic worlds: a furnished room, a garden before far hills. z is up, units metres."""

from collections.abc import Sequence

import numpy as np

from gsynopsis.scene.raycast import Paint, Spot, Surface, World, decode_srgb
from gsynopsis.scene.shapes import (
    Convex,
    Cylinder,
    Ellipsoid,
    Floats,
    Plane,
    Ridge,
    column,
    unit,
)
from gsynopsis.scene.textures import (
    cells,
    checker,
    disc,
    facing,
    mix,
    mottled,
    over,
    placed,
    plain,
    rectangle,
    shaded,
    stripes,
    waves,
)

ORBIT = {"room": 2.2, "outdoor": 3.0}
"""Radius of the ring of cameras, metres."""
ROOM = (3.5, 3.0, 2.8)
"""Half length, half width and height of the room, metres."""
FLAT = ((1, 0, 0), (0, 1, 0))
"""Rows of cells on a floor: along x, side by side along y."""
UPRIGHT = ((1, 1, 0), (0, 0, 1))
"""Rows of cells on all four sides of a box: level, one over the other."""


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


def room(seed: int) -> World:
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

    return World(surfaces, lights, False, light, ambient)


def _walls(seed: int) -> list[Surface]:
    length, width, height = ROOM
    grain = waves(seed, 0.6, 0.07, stretch=(5, 1, 1))
    planks = shaded(
        cells(seed, ("#a9764a", "#b98a5b", "#8f6038"), (1.7, 0.24), FLAT, 0.006), grain, 0.3
    )
    rings = _rings(plain("#8c2f39"), plain("#e8d3b0"), 0.42)
    wool = waves(seed + 1, 0.5, 0.06)
    floor = over(planks, shaded(rings, wool, 0.25), disc((0, 1), (0, 0), 1.75))
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
        ball((-0.4, 0.42, top + 0.11), (0.18, 0.12, 0.11), _lemon(seed + 5), gloss=0.25),
    ]


def _lemon(seed: int) -> Paint:
    return mottled(("#c98a00", "#f2c500", "#fbe36a"), waves(seed, 0.15, 0.04), 0.9)


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


def outdoor(seed: int) -> World:
    """A cottage garden; trees to 16 m, hills at 32, 45 and 62 orbit radii, a sky at 110."""
    surfaces = (*_horizon(seed), *_garden(seed + 20), *_trees(seed + 40))
    sun = column((0.55, -0.45, 0.72))
    jitter = ((0.03, 0.03), (-0.03, 0.03), (0.03, -0.03), (-0.03, -0.03))
    lights = np.stack([unit(sun + column((x, y, 0)))[:, 0] for x, y in jitter])
    sky, earth = decode_srgb("#a9c8ee") * 0.62, decode_srgb("#8a8a5c") * 0.35

    def ambient(spot: Spot) -> Floats:
        return mix(earth, sky, 0.5 + 0.5 * spot.normal[2])

    return World(surfaces, lights, True, decode_srgb("#fff0d2") * 1.0, ambient)


def _horizon(seed: int) -> list[Surface]:
    grass = mottled(("#3f5d23", "#5f8032", "#8aa347", "#b5b566"), waves(seed, 6.0, 0.15), 1.0)
    grass = shaded(grass, waves(seed + 1, 60.0, 8.0), 0.3)
    slabs = cells(seed + 2, ("#9a938a", "#b5aea2", "#857d73"), (0.5, 0.36), FLAT, 0.02)
    slabs = shaded(slabs, waves(seed + 3, 0.5, 0.07), 0.25)
    ground = over(grass, slabs, disc((0, 1), (0, 0), 1.95))
    ground = over(ground, slabs, rectangle((0, 1), (0, -6), (0.5, 6)))
    radius = ORBIT["outdoor"]
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
        Surface(dome, _sky(seed + 5, size), glows=True),
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


def _sky(seed: int, size: float) -> Paint:
    """Blue above, pale at the horizon, with clouds that are longer than high."""
    noise = waves(seed, 0.7 * size, 0.07 * size, (1, 1, 0.4))
    high, low, cloud = decode_srgb("#3f78c2"), decode_srgb("#cfe0f0"), decode_srgb("#ffffff")

    def paint(spot: Spot) -> Floats:
        height = np.maximum(spot.position[2] / np.float32(size), 0)
        blue = mix(low, high, 1.6 * height**0.7)
        return mix(blue, cloud, (0.25 + 0.9 * noise(spot)) * np.clip(height * 8 - 0.4, 0, 1))

    return paint


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
