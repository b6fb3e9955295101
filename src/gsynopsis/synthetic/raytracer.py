"""A small ray caster in NumPy: painted surfaces, one soft light, one mirror bounce.

It draws the synthetic scenes and nothing else. Vectors are float32 [3, n], one column a ray.
Colours are linear light until `encode_srgb`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gsynopsis.scene.camera import Camera
from gsynopsis.synthetic.shapes import NEAR, ONE_THREAD, Floats, Shape, column, dot, product, unit

RAYS_AT_ONCE = 1 << 16
SUBPIXELS = ((0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75))
"""Places of a pixel's four samples; sample k uses light k, which gives soft shadows."""
HIGHLIGHT_POWER = 60
FRESNEL_POWER = 5
LAMP_FALL = np.float32(0.12)
"""A lamp's light at a distance of r metres is 1 / (1 + LAMP_FALL r²) of that beside it."""
RAY_OFFSET = 2 * NEAR
"""Distance from their surface, world units, at which rays to lights and mirror images begin."""
MIRROR_BLUR = 4.0
"""Growth of a pixel's footprint after a curved mirror."""
NEAR_BLOCK = 1 << 12
"""Rays tested against all bounding spheres at once: what fits into the cache."""
ZERO = np.float32(0)
SLACK = np.float32(1e-3)
"""Square metres by which bounding spheres are too large, against rounding in float32."""
GRAZING = np.float32(0.2)
"""Smallest cosine at which a pixel's footprint on a surface is still stretched."""


@dataclass(frozen=True)
class Spot:
    """Points at which rays meet surfaces."""

    position: Floats  # [3, n] world units
    normal: Floats  # [3, n] unit length, towards the viewer's side
    footprint: Floats  # [n] width of a pixel there, world units

    def at(self, index: NDArray[np.intp] | slice) -> "Spot":
        """Some of the spots."""
        if isinstance(index, slice):
            return Spot(self.position[:, index], self.normal[:, index], self.footprint[index])
        position, normal = self.position.take(index, axis=1), self.normal.take(index, axis=1)
        return Spot(position, normal, self.footprint[index])


Paint = Callable[[Spot], Floats]
"""Colour at spots, linear RGB, float32 [3, n]."""


@dataclass(frozen=True)
class Surface:
    """A shape with its paint.

    Attributes:
        shape: Where it is.
        paint: Its colour.
        bound: Centre and radius of a sphere around it (x, y, z, r), or None if it has no end.
            Only bounded surfaces cast shadows; they are convex and seen from outside.
        gloss: Strength of the light's highlight, 0 to 1.
        mirror: Share of light reflected head on, 0 to 1; more at grazing angles.
        glows: The paint is what one sees, whatever the light.
    """

    shape: Shape
    paint: Paint
    bound: tuple[float, float, float, float] | None = None
    gloss: float = 0.0
    mirror: float = 0.0
    glows: bool = False


@dataclass(frozen=True)
class RayScene:
    """Surfaces that enclose the cameras, and the light.

    Attributes:
        surfaces: A ray from any camera meets at least one.
        lights: Four samples of the light, float32 [4, 3]: positions, or unit directions towards
            it if `sun`.
        sun: The light is infinitely far away and does not fall with distance.
        light: Its colour, linear RGB [3, 1].
        ambient: Light from everywhere else, linear RGB.
    """

    surfaces: tuple[Surface, ...]
    lights: Floats
    sun: bool
    light: Floats
    ambient: Paint


def _through(
    centers: Floats, squares: Floats, origin: Floats, direction: Floats
) -> NDArray[np.bool_]:
    """Mask [m, n] of rays that pass through spheres of centre [m, 3] and squared radius [m, 1].

    With away = c - o, a ray does if |away|² - r² < max(away · d, 0)², for all spheres at once.
    """
    if origin.shape[1] == 1:
        away = centers - origin.T
        free = (away * away).sum(axis=1, keepdims=True) - squares
        # From within a sphere every ray passes through it.
        least = np.where(free < 0, np.float32(-np.inf), np.sqrt(np.maximum(free, 0)))
        return away @ direction > least
    along = centers @ direction - dot(origin, direction)
    np.maximum(along, 0, out=along)
    along *= along
    free = (-2 * centers) @ origin
    free += dot(origin, origin)
    free += (centers * centers).sum(axis=1, keepdims=True) - squares
    return free < along


def _near(
    surfaces: Sequence[Surface], origin: Floats, direction: Floats, margin: np.float32 = ZERO
) -> list[NDArray[np.bool_] | None]:
    """Per surface, whether unit rays pass through its bounding sphere [n]; None if unbounded.

    Origins or directions may be [3, 1], shared by all rays; the spheres are larger by `margin`.
    """
    bounds = np.array([s.bound for s in surfaces if s.bound is not None], np.float32)
    if not len(bounds):
        return [None] * len(surfaces)
    centers, squares = bounds[:, :3], (bounds[:, 3:] + margin) ** 2 + SLACK
    count = (direction if origin.shape[1] == 1 else origin).shape[1]
    close = np.empty((len(bounds), count), np.bool_)
    step = min(NEAR_BLOCK, max(1, ONE_THREAD // centers.size))  # see `shapes.product`
    for start in range(0, count, step):
        block = slice(start, start + step)
        o, d = (v if v.shape[1] == 1 else v[:, block] for v in (origin, direction))
        close[:, block] = _through(centers, squares, o, d)
    rows = iter(close)
    return [None if s.bound is None else next(rows) for s in surfaces]


def _of(vectors: Floats, rays: NDArray[np.intp]) -> Floats:
    """Columns of some of the rays; the one column [3, 1] that all share as it is."""
    return vectors if vectors.shape[1] == 1 else vectors.take(rays, axis=1)


def nearest(
    surfaces: Sequence[Surface], origin: Floats, direction: Floats
) -> tuple[Floats, NDArray[np.int16]]:
    """Distance [n] to the first hit of each unit ray, and which surface (−1: none).

    Args:
        surfaces: What there is to hit.
        origin: Where the rays begin, [3, n], or [3, 1] for all.
        direction: Their unit directions, [3, n].
    """
    distance = np.full(direction.shape[1], np.inf, np.float32)
    which = np.full(direction.shape[1], -1, np.int16)
    for number, near in enumerate(_near(surfaces, origin, direction)):
        shape = surfaces[number].shape
        if near is None:
            t = shape.hit(origin, direction)
            np.copyto(which, np.int16(number), where=t < distance)
            np.minimum(distance, t, out=distance)
            continue
        rays = np.flatnonzero(near)
        if len(rays):
            t = shape.hit(_of(origin, rays), direction.take(rays, axis=1))
            closer = t < distance[rays]
            rays = rays[closer]
            distance[rays] = t[closer]
            which[rays] = number
    return distance, which


@dataclass(frozen=True)
class _Hits:
    """Rays sorted by the surface they hit, those on surfaces that glow last."""

    order: NDArray[np.intp]  # [n] number of each sorted ray among the unsorted
    groups: tuple[tuple[int, slice], ...]  # surface and its sorted rays, where it has any
    lit: int  # how many rays meet a surface that does not glow

    def of(self, surfaces: Sequence[Surface], name: str) -> list[tuple[float, slice]]:
        """Values of an attribute that is not 0, and the sorted rays they hold for."""
        values = [(getattr(surfaces[number], name), rays) for number, rays in self.groups]
        return [(value, rays) for value, rays in values if value]


def _sort(surfaces: Sequence[Surface], which: NDArray[np.int16]) -> _Hits:
    numbers = sorted(range(len(surfaces)), key=lambda number: surfaces[number].glows)
    rank = np.empty(len(surfaces), np.int16)
    rank[numbers] = np.arange(len(surfaces), dtype=np.int16)
    place = rank[which]
    ends = np.cumsum(np.bincount(place, minlength=len(surfaces))).tolist()
    parts = zip(numbers, [0, *ends], ends, strict=False)
    groups = tuple((number, slice(start, end)) for number, start, end in parts if end > start)
    lit = max((rays.stop for number, rays in groups if not surfaces[number].glows), default=0)
    return _Hits(np.argsort(place, kind="stable"), groups, lit)


def _spots(
    surfaces: Sequence[Surface],
    hits: _Hits,
    rays: tuple[Floats, Floats],
    distance: Floats,
    pixel: float,
) -> tuple[Spot, Floats]:
    """The spots that sorted rays hit and the paint there, linear RGB [3, n]."""
    origin, direction = rays
    position = origin + distance * direction
    normal, paint = np.empty_like(position), np.empty_like(position)
    footprint = distance * np.float32(pixel)
    for number, part in hits.groups:
        surface, place = surfaces[number], position[:, part]
        here = surface.shape.normal(place)
        normal[:, part] = here
        footprint[part] /= np.maximum(np.abs(dot(here, direction[:, part])), GRAZING)
        paint[:, part] = surface.paint(Spot(place, here, footprint[part]))
    return Spot(position, normal, footprint), paint


def _shadow(
    world: RayScene,
    hits: _Hits,
    start: Floats,
    towards: Floats,
    lamp: tuple[Floats, Floats] | None,
    open_: NDArray[np.bool_],
) -> None:
    """Takes from the spots that see the light those [n] which a bounded surface hides from it.

    Args:
        world: The world.
        hits: What the spots lie on, sorted.
        start: Where shadow rays begin, just off the spots, [3, n].
        towards: Unit directions to the light, [3, n], or [3, 1] for the sun.
        lamp: Where the lamp is, [3, 1], and its distances from the spots, [n]; None for the sun.
        open_: Spots that face the light [n]; written to.
    """
    own = dict(hits.groups)
    if lamp is None:
        close = _near(world.surfaces, start, towards)
    else:
        # The same lines seen from the lamp, which they pass as closely as they begin beside their
        # spots: to begin in one point is less to compute.
        close = _near(world.surfaces, lamp[0], -towards, margin=RAY_OFFSET)
    for number, near in enumerate(close):
        if near is None:
            continue
        if number in own:
            # Convex and seen from outside, it cannot hide from the light what faces it.
            near[own[number]] = False
        rays = np.flatnonzero(near & open_)
        if len(rays):
            t = world.surfaces[number].shape.hit(start.take(rays, axis=1), _of(towards, rays))
            open_[rays] = t >= (np.inf if lamp is None else lamp[1][rays])


def _light(
    world: RayScene, hits: _Hits, spot: Spot, view: Floats, sample: int
) -> tuple[Floats, list[tuple[Floats, slice]]]:
    """Direct light [n] by Lambert's law on sorted spots, and highlights where there is gloss."""
    source = world.lights[sample][:, None]
    if world.sun:
        towards, lamp, fall = source, None, None
    else:
        away = source - spot.position
        square = dot(away, away)
        lamp = source, np.sqrt(square)
        towards, fall = away / lamp[1], 1 / (1 + LAMP_FALL * square)
    cosine = np.maximum(dot(spot.normal, towards), 0)
    open_ = cosine > 0
    _shadow(world, hits, spot.position + RAY_OFFSET * spot.normal, towards, lamp, open_)
    cosine *= open_
    shine: list[tuple[Floats, slice]] = []
    for gloss, rays in hits.of(world.surfaces, "gloss"):
        if rays.stop > hits.lit:
            continue
        to = towards if world.sun else towards[:, rays]
        halfway = np.maximum(dot(spot.normal[:, rays], unit(to - view[:, rays])), 0)
        bright = np.where(open_[rays], halfway**HIGHLIGHT_POWER, np.float32(0))
        shine.append((np.float32(gloss) * bright, rays))
    return cosine if fall is None else cosine * fall, shine


def _reflected(
    world: RayScene, spot: Spot, view: Floats, pixel: float, sample: int
) -> tuple[Floats, Floats]:
    """Colours that mirrors reflect, linear RGB [3, n], and the cosine [n] of the angle of view."""
    facing = -dot(spot.normal, view)
    out = unit(view + 2 * facing * spot.normal)
    start = spot.position + RAY_OFFSET * spot.normal
    echo, _, _ = trace(world, (start, out), pixel * MIRROR_BLUR, sample, bounce=False)
    return echo, np.maximum(facing, 0)


def trace(
    world: RayScene, rays: tuple[Floats, Floats], pixel: float, sample: int, bounce: bool = True
) -> tuple[Floats, Floats, NDArray[np.int16]]:
    """Colours along rays.

    Args:
        world: The world; its surfaces must enclose the origins.
        rays: Origins, [3, n] or [3, 1] for all, and unit directions, [3, n].
        pixel: Width of a pixel at distance 1, world units.
        sample: Index of the sample of the light, 0 to 3.
        bounce: Follow reflections.

    Returns:
        Colours, linear RGB [3, n], distances [n], and the surfaces' numbers [n].
    """
    distance, which = nearest(world.surfaces, *rays)
    # Sorted by surface, the rays of each are a slice: no gathering for every paint and light.
    hits = _sort(world.surfaces, which)
    origin, view = _of(rays[0], hits.order), rays[1].take(hits.order, axis=1)
    spot, color = _spots(world.surfaces, hits, (origin, view), distance[hits.order], pixel)
    lit = slice(0, hits.lit)
    here = spot.at(lit)
    direct, shine = _light(world, hits, here, view[:, lit], sample)
    color[:, lit] *= world.ambient(here) + world.light * direct
    for bright, part in shine:
        color[:, part] += bright
    for mirror, part in hits.of(world.surfaces, "mirror") if bounce else ():
        echo, facing = _reflected(world, spot.at(part), view[:, part], pixel, sample)
        least = np.float32(mirror)
        share = least + (1 - least) * (1 - facing) ** FRESNEL_POWER
        color[:, part] = (1 - share) * color[:, part] + share * echo
    out = np.empty_like(color)
    for row, values in zip(out, color, strict=True):
        row[hits.order] = values
    return out, distance, which


def sunlight(towards: Sequence[float], blur: float) -> Floats:
    """Four samples of the light of a sun, for `RayScene.lights`; `blur` softens its shadows."""
    jitter = ((blur, blur), (-blur, blur), (blur, -blur), (-blur, -blur))
    return np.stack([unit(column(towards) + column((x, y, 0)))[:, 0] for x, y in jitter])


def camera_rays(camera: Camera, pixels: NDArray[np.float64]) -> tuple[Floats, Floats]:
    """Origins and unit directions, each float32 [3, n], through pixel coordinates [n, 2]."""
    local = np.ones((3, len(pixels)))
    local[0] = (pixels[:, 0] - camera.cx) / camera.fx
    local[1] = (pixels[:, 1] - camera.cy) / camera.fy
    world = product(camera.w2c[:3, :3].T, local)
    direction = (world / np.sqrt(dot(world, world))).astype(np.float32)
    return np.broadcast_to(camera.position.astype(np.float32)[:, None], direction.shape), direction


def encode_srgb(linear: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Linear light, clipped to [0, 1], as 8-bit sRGB of the same shape."""
    x = np.clip(linear, 0, 1)
    curve = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)
    return np.round(255 * curve).astype(np.uint8)


def decode_srgb(code: str) -> Floats:
    """A colour such as "#c8553d" as linear RGB, float32 [3, 1]."""
    x = np.array([int(code[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)
    return linear.astype(np.float32)[:, None]


def render(world: RayScene, camera: Camera) -> NDArray[np.uint8]:
    """The photo that a camera takes: uint8 [H, W, 3] sRGB, the mean of four samples a pixel."""
    y, x = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float64)
    corners = np.stack([x.ravel(), y.ravel()], axis=1)
    light = np.zeros((3, len(corners)), np.float32)
    for start in range(0, len(corners), RAYS_AT_ONCE):
        block = slice(start, start + RAYS_AT_ONCE)
        for sample, offset in enumerate(SUBPIXELS):
            rays = camera_rays(camera, corners[block] + offset)
            light[:, block] += trace(world, rays, 1 / camera.fx, sample)[0]
    return encode_srgb(light.T / len(SUBPIXELS)).reshape(camera.height, camera.width, 3)
