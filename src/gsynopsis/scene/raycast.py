"""A small ray caster in NumPy: painted surfaces, one soft light, one mirror bounce.

It draws the synthetic scenes and nothing else. Vectors are float32 [3, n], one column a ray.
Colours are linear light until `encode_srgb`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gsynopsis.scene.camera import Camera
from gsynopsis.scene.shapes import NEAR, Floats, Shape, dot, unit

RAYS_AT_ONCE = 1 << 16
SUBPIXELS = ((0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75))
"""Where in a pixel its four samples lie; sample k sees light k, which gives soft shadows."""
HIGHLIGHT_POWER = 60
FRESNEL_POWER = 5
LAMP_FALL = np.float32(0.12)
"""A lamp's light at a distance r metres is 1 / (1 + LAMP_FALL r²) of what it is near it."""
MIRROR_BLUR = 4.0
"""How much wider a pixel's footprint grows after a curved mirror."""
NEAR_BLOCK = 1 << 12
"""Rays tested against all bounding spheres at once: what fits into the cache."""
SLACK = np.float32(1e-3)
"""Square metres by which bounding spheres are too large, against rounding in float32."""
GRAZING = np.float32(0.2)
"""Smallest cosine at which a pixel's footprint on a surface is still stretched."""


@dataclass(frozen=True)
class Spot:
    """Where rays meet a surface."""

    position: Floats  # [3, n] world units
    normal: Floats  # [3, n] unit length, towards the viewer's side
    footprint: Floats  # [n] width of a pixel there, world units

    def at(self, index: NDArray[np.intp]) -> "Spot":
        """Some of the spots."""
        return Spot(self.position[:, index], self.normal[:, index], self.footprint[index])


Paint = Callable[[Spot], Floats]
"""Colour at spots, linear RGB, float32 [3, n]."""


@dataclass(frozen=True)
class Surface:
    """A shape with its paint.

    Attributes:
        shape: Where it is.
        paint: Its colour.
        bound: Centre and radius of a sphere around it (x, y, z, r), or None if it has no end.
            Only bounded surfaces cast shadows.
        gloss: Strength of the light's highlight, 0 to 1.
        mirror: Share of what it reflects head on, 0 to 1; more at grazing angles.
        glows: The paint is what one sees, whatever the light.
    """

    shape: Shape
    paint: Paint
    bound: tuple[float, float, float, float] | None = None
    gloss: float = 0.0
    mirror: float = 0.0
    glows: bool = False


@dataclass(frozen=True)
class World:
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


def _near(
    surfaces: Sequence[Surface], origin: Floats, direction: Floats
) -> list[NDArray[np.bool_] | None]:
    """Per surface, whether unit rays pass through its bounding sphere [n]; None if unbounded."""
    bounds = np.array([s.bound for s in surfaces if s.bound is not None], np.float32)
    if not len(bounds):
        return [None] * len(surfaces)
    centers, squares = bounds[:, :3], bounds[:, 3:] ** 2 + SLACK
    close = np.empty((len(bounds), direction.shape[1]), np.bool_)
    shared = origin.strides[1] == 0
    for start in range(0, direction.shape[1], NEAR_BLOCK):
        block = slice(start, start + NEAR_BLOCK)
        o, d = origin[:, :1] if shared else origin[:, block], direction[:, block]
        # With away = c - o: the ray goes through if |away|² - r² < max(away · d, 0)², both as
        # matrix products over all surfaces at once.
        along = centers @ d
        along -= dot(o, d)
        np.maximum(along, 0, out=along)
        along *= along
        away = (-2 * centers) @ o
        away += dot(o, o)
        away += (centers * centers).sum(axis=1, keepdims=True) - squares
        np.less(away, along, out=close[:, block])
    rows = iter(close)
    return [None if s.bound is None else next(rows) for s in surfaces]


def nearest(
    surfaces: Sequence[Surface], origin: Floats, direction: Floats
) -> tuple[Floats, NDArray[np.intp]]:
    """Distance [n] to the first hit of each unit ray [3, n], and which surface (−1: none)."""
    distance = np.full(direction.shape[1], np.inf, np.float32)
    which = np.full(direction.shape[1], -1, np.intp)
    for number, near in enumerate(_near(surfaces, origin, direction)):
        shape = surfaces[number].shape
        if near is None:
            t = shape.hit(origin, direction)
            which[t < distance] = number
            distance = np.minimum(distance, t)
            continue
        rays = np.flatnonzero(near)
        t = shape.hit(origin[:, rays], direction[:, rays])
        closer = t < distance[rays]
        distance[rays[closer]] = t[closer]
        which[rays[closer]] = number
    return distance, which


def _shadowed(world: World, origin: Floats, direction: Floats, limit: Floats) -> NDArray[np.bool_]:
    """Whether a bounded surface stands within `limit` [n] along each ray [3, n]."""
    dark = np.zeros(direction.shape[1], np.bool_)
    for surface, near in zip(world.surfaces, _near(world.surfaces, origin, direction), strict=True):
        if near is not None:
            rays = np.flatnonzero(near)
            dark[rays] |= surface.shape.hit(origin[:, rays], direction[:, rays]) < limit[rays]
    return dark


def _light(world: World, spot: Spot, view: Floats, sample: int) -> tuple[Floats, Floats]:
    """Direct light [n] by Lambert's law, and the highlight [n] of a glossy surface."""
    source = world.lights[sample][:, None]
    if world.sun:
        towards, limit = source, np.full_like(spot.footprint, np.inf)
        fall = np.ones_like(limit)
    else:
        away = source - spot.position
        square = dot(away, away)
        limit = np.sqrt(square)
        towards, fall = away / limit, 1 / (1 + LAMP_FALL * square)
    cosine = np.maximum(dot(spot.normal, towards), 0)
    lit = np.flatnonzero(cosine > 0)
    towards = np.broadcast_to(towards, view.shape)
    start = spot.position[:, lit] + NEAR * 2 * spot.normal[:, lit]
    cosine[lit[_shadowed(world, start, towards[:, lit], limit[lit])]] = 0
    halfway = np.maximum(dot(spot.normal, unit(towards - view)), 0)
    return cosine * fall, np.where(cosine > 0, halfway**HIGHLIGHT_POWER, np.float32(0))


def _spots(
    world: World,
    rays: tuple[Floats, Floats],
    distance: Floats,
    which: NDArray[np.intp],
    pixel: float,
) -> tuple[Spot, Floats]:
    """The spots that rays hit and the paint there, linear RGB [3, n]."""
    origin, direction = rays
    position = origin + distance * direction
    normal, paint = np.empty_like(position), np.empty_like(position)
    footprint = distance * np.float32(pixel)
    for number, surface in enumerate(world.surfaces):
        hits = np.flatnonzero(which == number)
        if len(hits):
            here = surface.shape.normal(position[:, hits])
            normal[:, hits] = here
            footprint[hits] /= np.maximum(np.abs(dot(here, direction[:, hits])), GRAZING)
            paint[:, hits] = surface.paint(Spot(position[:, hits], here, footprint[hits]))
    return Spot(position, normal, footprint), paint


def _reflected(
    world: World, spot: Spot, view: Floats, pixel: float, sample: int
) -> tuple[Floats, Floats]:
    """What mirrors at spots show, linear RGB [3, n], and the cosine [n] they are seen under."""
    facing = -dot(spot.normal, view)
    out = unit(view + 2 * facing * spot.normal)
    start = spot.position + NEAR * 2 * spot.normal
    echo, _, _ = trace(world, (start, out), pixel * MIRROR_BLUR, sample, bounce=False)
    return echo, np.maximum(facing, 0)


def trace(
    world: World, rays: tuple[Floats, Floats], pixel: float, sample: int, bounce: bool = True
) -> tuple[Floats, Floats, NDArray[np.intp]]:
    """What rays see.

    Args:
        world: The world; its surfaces must enclose the origins.
        rays: Origins and unit directions, each [3, n].
        pixel: Width of a pixel at distance 1, world units.
        sample: Which of the four samples of the light shines.
        bounce: Follow reflections.

    Returns:
        Colours, linear RGB [3, n], distances [n], and the surfaces' numbers [n].
    """
    origin, direction = rays
    distance, which = nearest(world.surfaces, origin, direction)
    spot, color = _spots(world, rays, distance, which, pixel)
    gloss = np.array([s.gloss for s in world.surfaces], np.float32)[which]
    mirror = np.array([s.mirror for s in world.surfaces], np.float32)[which]
    lit = np.flatnonzero(~np.array([s.glows for s in world.surfaces])[which])
    here = spot.at(lit)
    direct, highlight = _light(world, here, direction[:, lit], sample)
    shade = world.ambient(here) + world.light * direct
    color[:, lit] = color[:, lit] * shade + gloss[lit] * highlight
    shiny = np.flatnonzero(mirror > 0)
    if bounce and len(shiny):
        echo, facing = _reflected(world, spot.at(shiny), direction[:, shiny], pixel, sample)
        share = mirror[shiny] + (1 - mirror[shiny]) * (1 - facing) ** FRESNEL_POWER
        color[:, shiny] = (1 - share) * color[:, shiny] + share * echo
    return color, distance, which


def camera_rays(camera: Camera, pixels: NDArray[np.float64]) -> tuple[Floats, Floats]:
    """Origins and unit directions, each float32 [3, n], through pixel coordinates [n, 2]."""
    local = np.ones((len(pixels), 3))
    local[:, 0] = (pixels[:, 0] - camera.cx) / camera.fx
    local[:, 1] = (pixels[:, 1] - camera.cy) / camera.fy
    world = local @ camera.w2c[:3, :3]
    world /= np.linalg.norm(world, axis=1, keepdims=True)
    direction = np.ascontiguousarray(world.T, np.float32)
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


def render(world: World, camera: Camera) -> NDArray[np.uint8]:
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
