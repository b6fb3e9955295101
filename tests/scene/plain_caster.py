"""The ray caster without any short cut: every ray against every surface, nothing sorted."""

import numpy as np
from numpy.typing import NDArray

from gsynopsis.scene.camera import Camera
from gsynopsis.synthetic.raytracer import (
    FRESNEL_POWER,
    GRAZING,
    HIGHLIGHT_POWER,
    LAMP_FALL,
    MIRROR_BLUR,
    RAY_OFFSET,
    SUBPIXELS,
    RayScene,
    Spot,
    camera_rays,
    encode_srgb,
)
from gsynopsis.synthetic.shapes import Floats, dot, unit


def plain_hits(world: RayScene, origin: Floats, direction: Floats) -> Floats:
    """Distance of every ray to every surface, [surfaces, n]."""
    return np.stack([s.shape.hit(origin, direction) for s in world.surfaces])


def plain_light(world: RayScene, spot: Spot, view: Floats, sample: int) -> tuple[Floats, Floats]:
    """Direct light [n] and highlight [n], for all spots alike."""
    source = world.lights[sample][:, None]
    away = source if world.sun else source - spot.position
    limit = np.full_like(spot.footprint, np.inf) if world.sun else np.sqrt(dot(away, away))
    towards = np.broadcast_to(away if world.sun else away / limit, view.shape)
    fall = np.float32(1) if world.sun else 1 / (1 + LAMP_FALL * dot(away, away))
    cosine = np.maximum(dot(spot.normal, towards), 0)
    reach = plain_hits(world, spot.position + RAY_OFFSET * spot.normal, towards)
    casts = np.array([s.bound is not None for s in world.surfaces])
    cosine[(reach[casts] < limit).any(axis=0)] = 0
    halfway = np.maximum(dot(spot.normal, unit(towards - view)), 0)
    return cosine * fall, np.where(cosine > 0, halfway**HIGHLIGHT_POWER, np.float32(0))


def plain_trace(
    world: RayScene, rays: tuple[Floats, Floats], pixel: float, sample: int, bounce: bool = True
) -> Floats:
    """Colours that rays see, linear RGB [3, n]; see `raycast.trace`."""
    origin, direction = rays
    reach = plain_hits(world, origin, direction)
    which, distance = reach.argmin(axis=0), reach.min(axis=0)
    position = origin + distance * direction
    normal, paint = np.empty_like(position), np.empty_like(position)
    footprint = distance * np.float32(pixel)
    for number, surface in enumerate(world.surfaces):
        mine = which == number
        here = surface.shape.normal(position[:, mine])
        normal[:, mine] = here
        footprint[mine] /= np.maximum(np.abs(dot(here, direction[:, mine])), GRAZING)
        paint[:, mine] = surface.paint(Spot(position[:, mine], here, footprint[mine]))
    spot = Spot(position, normal, footprint)
    gloss, mirror = (
        np.array([getattr(s, name) for s in world.surfaces], np.float32)[which]
        for name in ("gloss", "mirror")
    )
    glows = np.array([s.glows for s in world.surfaces])[which]
    direct, highlight = plain_light(world, spot, direction, sample)
    lit = paint * (world.ambient(spot) + world.light * direct) + gloss * highlight
    color = np.where(glows, paint, lit)
    if bounce and (mirror > 0).any():
        facing = -dot(normal, direction)
        out = unit(direction + 2 * facing * normal)
        start = position + RAY_OFFSET * normal
        shiny = mirror > 0
        turned = start[:, shiny], out[:, shiny]
        echo = plain_trace(world, turned, pixel * MIRROR_BLUR, sample, bounce=False)
        head_on = mirror[shiny]
        share = head_on + (1 - head_on) * (1 - np.maximum(facing[shiny], 0)) ** FRESNEL_POWER
        color[:, shiny] = (1 - share) * color[:, shiny] + share * echo
    return color


def plain_render(world: RayScene, camera: Camera) -> NDArray[np.uint8]:
    """The photo that a camera takes, uint8 [H, W, 3] sRGB; see `raycast.render`."""
    y, x = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float64)
    corners = np.stack([x.ravel(), y.ravel()], axis=1)
    light = np.zeros((3, len(corners)), np.float32)
    for sample, offset in enumerate(SUBPIXELS):
        light += plain_trace(world, camera_rays(camera, corners + offset), 1 / camera.fx, sample)
    return encode_srgb(light.T / len(SUBPIXELS)).reshape(camera.height, camera.width, 3)
