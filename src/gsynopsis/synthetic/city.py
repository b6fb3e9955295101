"""The synthetic city: blocks of houses between streets, in a meadow. z is up, metres."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gsynopsis.synthetic.objects import ball, block, post
from gsynopsis.synthetic.raytracer import Paint, RayScene, Spot, Surface, decode_srgb, sunlight
from gsynopsis.synthetic.shapes import Ellipsoid, Floats, Plane, column
from gsynopsis.synthetic.textures import (
    FLAT,
    UPRIGHT,
    cells,
    facing,
    from_all_sides,
    mottled,
    over,
    placed,
    plain,
    rectangle,
    shaded,
    sky,
    waves,
)

Place = NDArray[np.float64]
"""Metres, [3]."""
PITCH = 24.0
"""From the middle of a street to that of the next, metres."""
STREET = 7.0
"""Width of a street."""
DOME = 40.0
"""Radius of the sky, in pitches."""
WALLS = (
    ("#b0573f", "#9c4a34", "#c06a4f"),
    ("#d8cbb3", "#c7b596", "#e6dcc8"),
    ("#8f9aa3", "#a5b0b8", "#7b868f"),
    ("#c9a24a", "#b58d3a", "#dcb968"),
    ("#6f8f77", "#5d7d66", "#86a58c"),
)
ROOFS = ("#7a3b2c", "#5b5f66", "#8c6a4a", "#4a4d55")
GREENS = ("#1d3b1a", "#3c6b2a", "#86a845")


def grid_of(views: int) -> tuple[int, int]:
    """Blocks along x and y for `views` photos: one for about ten, half as many rows as columns."""
    across = max(2, round(float(np.sqrt(views / 10 * 1.6))))
    return across, max(2, round(views / 10 / across))


def world(seed: int, grid: tuple[int, int]) -> RayScene:
    """A city of `grid` blocks around the origin under an open sky."""
    size = DOME * PITCH
    dome = Ellipsoid(column((0, 0, 0)), column((size, size, size)), inside=True)
    ground = Surface(Plane(column((0, 0, 1)), 0), _ground(seed, grid))
    surfaces = [ground, Surface(dome, sky(seed + 5, size), glows=True)]
    rng = np.random.default_rng(seed)
    for x, y in block_centers(grid):
        surfaces += _houses(rng, (x, y), seed + len(surfaces))
    lights = sunlight((0.45, -0.6, 0.66), 0.012)
    ambient = from_all_sides(decode_srgb("#8a8578") * 0.35, decode_srgb("#a9c8ee") * 0.62)
    return RayScene(tuple(surfaces), lights, True, decode_srgb("#fff0d2") * 1.0, ambient)


def block_centers(grid: tuple[int, int]) -> list[tuple[float, float]]:
    """Middles of the blocks, metres, row by row."""
    across, along = grid
    return [
        ((i - (across - 1) / 2) * PITCH, (j - (along - 1) / 2) * PITCH)
        for j in range(along)
        for i in range(across)
    ]


def flight(views: int, grid: tuple[int, int], seed: int) -> list[tuple[Place, Place]]:
    """Positions and targets of cameras: along every street, low over the roofs.

    They look along the street and to both sides in turn, down at the houses of the next block.
    """
    rng = np.random.default_rng(seed)
    across, along = grid
    streets = np.linspace(-along / 2, along / 2, along + 1) * PITCH
    reach = across * PITCH / 2
    flown: list[tuple[Place, Place]] = []
    for number in range(views):
        way = (number + 0.5) / views * len(streets)
        row = min(int(way), len(streets) - 1)
        x = (2 * (way - row) - 1) * reach * (1 if row % 2 == 0 else -1)
        wobble = rng.uniform(-1, 1, 4)
        position = np.array([x, streets[row] + wobble[0], 13 + 3 * wobble[1]])
        turn = np.pi / 2 * (number % 4) + 0.3 * wobble[2]
        ahead = np.array([np.cos(turn), np.sin(turn), 0]) * PITCH * (1.1 + 0.3 * wobble[3])
        flown.append((position, position * (1, 1, 0) + ahead + (0, 0, 2.5)))
    return flown


def _ground(seed: int, grid: tuple[int, int]) -> Paint:
    """Asphalt with dashed lines, pavements, and yards within the blocks; a meadow around them."""
    shift = tuple(0.0 if count % 2 else PITCH / 2 for count in grid)
    asphalt = mottled(("#3a3b3e", "#4a4b4f", "#5a5a5c"), waves(seed, 3.0, 0.2), 0.9)
    slabs = cells(seed + 1, ("#a39c92", "#b8b0a4", "#8f887e"), (0.9, 0.6), FLAT, 0.02)
    yard = mottled(("#4f6b2e", "#7d8a4a", "#a59a78"), waves(seed + 2, 5.0, 0.3), 1.0)
    street = over(asphalt, plain("#e8e2cf"), _dashes)
    paved = over(street, slabs, _within(PITCH - STREET))
    streets = placed(over(paved, yard, _within(PITCH - STREET - 3.2)), (*shift, 0.0))
    meadow = mottled(("#55682f", "#7f8d48", "#a8a868"), waves(seed + 3, 60.0, 1.0), 1.0)
    half_x, half_y = (count * PITCH / 2 + STREET / 2 for count in grid)
    return over(meadow, streets, rectangle((0, 1), (0, 0), (half_x, half_y)))


def _beside(x: Floats) -> Floats:
    """Distance to the middle of the nearest block along an axis, where there is one at 0."""
    return np.abs((x / np.float32(PITCH) + 0.5) % 1 - np.float32(0.5)) * np.float32(PITCH)


def _within(width: float) -> Callable[[Spot], Floats]:
    """Depth inside squares of a width in the middle of each block."""

    def inside(spot: Spot) -> Floats:
        half = np.float32(width / 2)
        return np.minimum(half - _beside(spot.position[0]), half - _beside(spot.position[1]))

    return inside


def _dashes(spot: Spot) -> Floats:
    x, y = (np.float32(PITCH / 2) - _beside(spot.position[axis]) for axis in (0, 1))
    first = np.minimum(np.float32(0.09) - x, np.abs(spot.position[1] % 4 - 2) - np.float32(0.9))
    second = np.minimum(np.float32(0.09) - y, np.abs(spot.position[0] % 4 - 2) - np.float32(0.9))
    return np.maximum(first, second)


def _houses(rng: np.random.Generator, middle: tuple[float, float], seed: int) -> list[Surface]:
    """Four houses on the corners of a block, each with a roof; a tree in the yard."""
    surfaces: list[Surface] = []
    for dx, dy in ((-4.4, -4.4), (4.4, -4.4), (-4.4, 4.4), (4.4, 4.4)):
        x, y = middle[0] + dx, middle[1] + dy
        wide, deep = rng.uniform(5.2, 7.6, 2)
        tall = float(rng.uniform(5.0, 11.0))
        brick = cells(seed, WALLS[int(rng.integers(len(WALLS)))], (0.7, 0.35), UPRIGHT, 0.02)
        wall = shaded(brick, waves(seed + 1, 2.0, 0.2), 0.15)
        wall = over(wall, plain("#25313d"), _windows(float(rng.uniform(1.6, 2.2))))
        cover = shaded(plain(str(rng.choice(ROOFS))), waves(seed + 2, 1.5, 0.2), 0.3)
        surfaces.append(block((x, y, 0), (wide, deep, tall), 0, facing(wall, cover, 2)))
        if rng.uniform() < 0.6:
            gable = facing(cover, wall, 0)
            surfaces.append(
                block((x, y, tall), (wide + 0.4, deep + 0.4, 0.05), 0, gable, float(deep * 0.3))
            )
        seed += 3
    leaf = mottled(GREENS, waves(seed, 1.2, 0.2), 1.1)
    x, y = (m + float(d) for m, d in zip(middle, rng.uniform(-0.6, 0.6, 2), strict=True))
    surfaces.append(post((x, y, 0), 0.18, 2.2, plain("#5a4130")))
    surfaces.append(ball((x, y, 3.1), (1.2, 1.2, 1.5), leaf))
    return surfaces


def _windows(pitch: float) -> Callable[[Spot], Floats]:
    """Depth inside windows, in rows of a house's four walls, in its own axes."""

    def inside(spot: Spot) -> Floats:
        # Along x on walls that face along y, and the other way round.
        first = (np.abs(spot.normal[0]) > 0.5).astype(np.float32)
        side = first * spot.position[1] + (1 - first) * spot.position[0]
        across = np.abs((side / np.float32(pitch)) % 1 - np.float32(0.5)) * np.float32(pitch)
        up = np.abs((spot.position[2] / np.float32(2.6)) % 1 - np.float32(0.55)) * np.float32(2.6)
        return np.minimum(np.float32(0.45) - across, np.float32(0.65) - up)

    return inside
