"""Paints for the synthetic scenes: smooth noise and patterns that a pixel's width fades out.

Every pattern loses contrast where it is finer than the pixel that sees it, so that images from
different distances agree and nothing flickers between views.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from gsynopsis.synthetic.raytracer import Paint, Spot, decode_srgb
from gsynopsis.synthetic.shapes import Floats, column, dot, product

WAVES_PER_BAND = 8
BAND_RATIO = 2.0
"""Each band's wavelength over the next finer one's."""
AT_ONCE = 1 << 13
"""Spots whose waves are summed at once: what fits into the cache."""
FLAT = ((1, 0, 0), (0, 1, 0))
"""Rows of cells on a floor: along x, side by side along y."""
UPRIGHT = ((1, 1, 0), (0, 0, 1))
"""Rows of cells on all four sides of a box: level, one over the other."""

Noise = Callable[[Spot], Floats]
"""A field [n], mean 0, about 95 % of it within ±1."""


def waves(
    seed: int, longest: float, shortest: float, stretch: Sequence[float] = (1, 1, 1)
) -> Noise:
    """Band-limited noise: random plane waves with wavelengths between two lengths, world units.

    Args:
        seed: Seed of the waves.
        longest: Longest wavelength.
        shortest: Shortest wavelength.
        stretch: Factor on the wavelengths along x, y and z.
    """
    rng = np.random.default_rng(seed)
    bands = max(1, round(np.log(longest / shortest) / np.log(BAND_RATIO)) + 1)
    lengths = np.geomspace(longest, shortest, bands)
    amplitudes = lengths**0.7
    # The sum's standard deviation is 1/2: a cosine's is 1/√2.
    amplitudes *= 0.5 / np.sqrt(np.sum(amplitudes**2) * WAVES_PER_BAND / 2)
    parts: list[tuple[Floats, Floats, float, float]] = []
    for length, amplitude in zip(lengths, amplitudes, strict=True):
        ray = rng.standard_normal((WAVES_PER_BAND, 3))
        ray *= 2 * np.pi / length / np.linalg.norm(ray, axis=1, keepdims=True)
        phase = rng.uniform(0, 2 * np.pi, (WAVES_PER_BAND, 1)).astype(np.float32)
        vectors = (ray / np.array(stretch)).astype(np.float32)
        parts.append((vectors, phase, float(amplitude), float(length * min(stretch))))

    def field(spot: Spot) -> Floats:
        total = np.zeros_like(spot.footprint)
        for start in range(0, len(total), AT_ONCE):
            block = slice(start, start + AT_ONCE)
            position, footprint = spot.position[:, block], spot.footprint[block]
            for vectors, phase, amplitude, length in parts:
                wave = product(vectors, position)
                wave += phase
                wave = np.cos(wave, out=wave).sum(axis=0)
                total[block] += np.float32(amplitude) * _fade(footprint, length) * wave
        return total

    return field


def _fade(footprint: Floats, length: float) -> Floats:
    """Contrast that is left of a pattern of some wavelength when a pixel has this width."""
    ratio = footprint * np.float32(2.5 / length)
    return np.exp(-ratio * ratio)


def mix(a: Floats, b: Floats, share: Floats) -> Floats:
    """Colours a [3, ...] to b [3, ...] as the share [n] goes from 0 to 1, clipped."""
    return a + (b - a) * np.clip(share, 0, 1)


def from_all_sides(below: Floats, above: Floats) -> Paint:
    """Light of a sky and of a ground that mirrors it, for `RayScene.ambient`."""
    return lambda spot: mix(below, above, 0.5 + 0.5 * spot.normal[2])


def plain(color: str) -> Paint:
    """One colour."""
    value = decode_srgb(color)
    return lambda spot: np.broadcast_to(value, spot.position.shape)


def mottled(colors: Sequence[str], noise: Noise, contrast: float = 1.0) -> Paint:
    """Colours from the first to the last as the noise goes from −1 to 1."""
    palette = np.concatenate([decode_srgb(color) for color in colors], axis=1)
    knots = np.linspace(0, 1, len(colors))

    def paint(spot: Spot) -> Floats:
        share = 0.5 + 0.5 * contrast * noise(spot)
        out = np.empty((3, len(share)), np.float32)
        for row, values in zip(out, palette, strict=True):
            row[:] = np.interp(share, knots, values)
        return out

    return paint


def shaded(base: Paint, noise: Noise, depth: float) -> Paint:
    """A paint made lighter and darker by noise, ± depth."""
    return lambda spot: base(spot) * np.maximum(1 + np.float32(depth) * noise(spot), 0)


def sky(seed: int, size: float) -> Paint:
    """Blue above, pale at the horizon, with clouds longer than high, on a dome of radius `size`."""
    noise = waves(seed, 0.7 * size, 0.07 * size, (1, 1, 0.4))
    high, low, cloud = decode_srgb("#3f78c2"), decode_srgb("#cfe0f0"), decode_srgb("#ffffff")

    def paint(spot: Spot) -> Floats:
        height = np.maximum(spot.position[2] / np.float32(size), 0)
        blue = mix(low, high, 1.6 * height**0.7)
        return mix(blue, cloud, (0.25 + 0.9 * noise(spot)) * np.clip(height * 8 - 0.4, 0, 1))

    return paint


def square_wave(x: Floats, width: Floats) -> Floats:
    """A wave between 0 and 1 of period 1 whose edges are `width` [n] wide, in periods."""
    ramp = np.abs((x % 1) - np.float32(0.5)) * 2
    sharp = np.clip((ramp - np.float32(0.5)) / np.maximum(4 * width, 1e-4) + 0.5, 0, 1)
    # A pixel as wide as the period sees the mean.
    return np.float32(0.5) + (sharp - np.float32(0.5)) * np.exp(-((width * 1.5) ** 2))


def stripes(a: Paint, b: Paint, along: Sequence[float], period: float) -> Paint:
    """Stripes across the direction `along`, each half a period wide, world units."""
    axis = column(along)

    def paint(spot: Spot) -> Floats:
        x = dot(axis, spot.position) / np.float32(period)
        return mix(a(spot), b(spot), square_wave(x, spot.footprint / np.float32(period)))

    return paint


def checker(a: Paint, b: Paint, size: float, axes: Sequence[int] = (0, 1, 2)) -> Paint:
    """A checkerboard over the given axes, squares of `size` world units."""

    def paint(spot: Spot) -> Floats:
        sign = np.ones_like(spot.footprint)
        width = spot.footprint / np.float32(2 * size)
        for axis in axes:
            x = spot.position[axis] / np.float32(2 * size)
            sign = sign * (2 * square_wave(x, width) - 1)
        return mix(a(spot), b(spot), 0.5 + 0.5 * sign)

    return paint


def cells(
    seed: int,
    colors: Sequence[str],
    size: tuple[float, float],
    axes: tuple[Sequence[float], Sequence[float]],
    gap: float,
) -> Paint:
    """Bricks, planks or books: cells of random colours with dark gaps, every second row shifted.

    Args:
        seed: Seed of the colours.
        colors: What to choose from.
        size: Length along the first and the second direction, world units.
        axes: The direction along a row, and the one across rows.
        gap: Width of the gaps, world units.
    """
    palette = np.concatenate([decode_srgb(color) for color in colors], axis=1)
    rng = np.random.default_rng(seed)
    table = palette[:, rng.integers(len(colors), size=256)] * rng.uniform(0.75, 1.15, 256)
    table = table.astype(np.float32)
    along, across = column(axes[0]), column(axes[1])

    def paint(spot: Spot) -> Floats:
        v = dot(across, spot.position) / np.float32(size[1])
        row = np.floor(v)
        u = dot(along, spot.position) / np.float32(size[0]) + np.float32(0.5) * (row % 2)
        which = (np.floor(u) * 37 + row * 101).astype(np.int64) & 255
        soft = spot.footprint + np.float32(1e-3)
        shade = np.ones_like(v)
        for x, length in ((u, size[0]), (v, size[1])):
            edge = (np.float32(0.5) - np.abs(x % 1 - np.float32(0.5))) * np.float32(length)
            line = np.clip((np.float32(gap) - edge) / soft + 0.5, 0, 1)
            shade = shade * (1 - np.float32(0.55) * line * np.minimum(gap / soft, 1))
        return table[:, which] * shade

    return paint


def placed(paint: Paint, center: Sequence[float], yaw: float = 0.0) -> Paint:
    """A paint that moves with its object: seen in axes at `center`, turned by `yaw` radians."""
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]], np.float32)
    middle = column(center)

    def local(spot: Spot) -> Floats:
        return paint(
            Spot(product(turn, spot.position - middle), product(turn, spot.normal), spot.footprint)
        )

    return local


def facing(base: Paint, side: Paint, axis: int) -> Paint:
    """`side` where a surface looks along an axis, `base` elsewhere."""
    return lambda spot: _where(np.abs(spot.normal[axis]) > 0.9, side, base, spot)


def _where(mask: NDArray[np.bool_], yes: Paint, no: Paint, spot: Spot) -> Floats:
    """`yes` at the spots of a mask and `no` at the others, neither asked about more than that."""
    out = np.empty_like(spot.position)
    for paint, wanted in ((yes, mask), (no, ~mask)):
        index = np.flatnonzero(wanted)
        if len(index):
            _put(out, index, paint(spot.at(index)))
    return out


def _put(out: Floats, index: NDArray[np.intp], colors: Floats) -> None:
    """Writes colours [3, m] to columns of [3, n]; row by row, as NumPy is slow at both at once."""
    for row, values in zip(out, colors, strict=True):
        row[index] = values


def over(base: Paint, top: Paint, inside: Callable[[Spot], Floats]) -> Paint:
    """`top` where the signed depth `inside` [n], world units, is positive, with soft edges."""

    def paint(spot: Spot) -> Floats:
        share = np.clip(inside(spot) / np.maximum(spot.footprint, 1e-4) + 0.5, 0, 1)
        inner = np.flatnonzero(share)
        if not len(inner):
            return base(spot)
        if len(inner) == len(share):
            return mix(base(spot), top(spot), share)
        color = np.array(base(spot))
        _put(color, inner, mix(color.take(inner, axis=1), top(spot.at(inner)), share[inner]))
        return color

    return paint


def rectangle(
    axes: tuple[int, int], center: tuple[float, float], half: tuple[float, float]
) -> Callable[[Spot], Floats]:
    """Depth inside a rectangle on two axes, for `over`."""

    def inside(spot: Spot) -> Floats:
        x = np.float32(half[0]) - np.abs(spot.position[axes[0]] - np.float32(center[0]))
        y = np.float32(half[1]) - np.abs(spot.position[axes[1]] - np.float32(center[1]))
        return np.minimum(x, y)

    return inside


def disc(radius: float) -> Callable[[Spot], Floats]:
    """Depth inside a disc around the z axis, for `over`."""

    def inside(spot: Spot) -> Floats:
        x, y = spot.position[:2]
        return np.float32(radius) - np.sqrt(x * x + y * y)

    return inside
