"""Cameras that see something of Gaussians without photos, around them or among them (ours)."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from gsynopsis.cameras.placement import (
    NEARER,
    WHOLLY,
    Float64,
    FreePlaces,
    Subject,
    camera_at,
    cameras_among,
    cameras_around,
    free_places,
    lens_of,
)
from gsynopsis.model.splats import SplatModel
from gsynopsis.render.base import Gaussians, Renderer
from gsynopsis.scene.camera import Camera

LOOK_WIDTH = 240
"""Width of the images that say what a camera sees, pixels."""
DROPPED = 1 / 3
"""A larger share of dropped cameras says that those left tell little of the scene."""
OPAQUE = 0.5
"""Alpha from which on something is there."""
NEAR, NEAR_SHARE = 0.15, 0.25
"""Share of the usual depth; largest share of an image that may show what is nearer."""
FILLED, LITTLE = 0.1, 0.01
"""Least share of a picture that shows the subject: alone, and where much of it is seen."""
MUCH = 0.1
"""Share of the subject that is much."""
TILTS, TURNS = (-0.6, 0.1, 0.6), 4
"""Elevations of cameras around, radians, and sides: none looks into a room from high above."""
POINTS = 4096
"""Points of a subject that are looked for, about."""
BEHIND = 0.1
"""Share of the radius up to which what is behind a surface is part of it: splats lie in layers."""
HIDDEN, PLACES = 0.13, 8
"""Share that is hidden from around, from which on places among things, so many, may show more."""


@dataclass(frozen=True)
class Sighting:
    """A small picture from a camera, and the part of a subject that is seen in it.

    Attributes:
        filled: Share of the picture that shows the subject.
        seen: Points of the subject that are seen, bool [P].
        depths: Of each pixel, world units, infinite where nothing is [H, W].
    """

    filled: float
    seen: NDArray[np.bool_]
    depths: Float64


@dataclass(frozen=True)
class Screened:
    """Cameras that see something, or others where none does.

    Attributes:
        cameras: Of each set that was asked for.
        tried: How many there were of all sets.
        near: Of these, dropped as something opaque is right before them.
        empty: Others, dropped as they see too little.
        blind: All of some set had to be dropped.
    """

    cameras: tuple[list[Camera], ...]
    tried: int
    near: int
    empty: int
    blind: bool = False

    @property
    def trusted(self) -> bool:
        """So few were dropped that figures from the rest tell of the scene."""
        return not self.blind and self.near + self.empty <= DROPPED * self.tried

    def __str__(self) -> str:
        """Counts of dropped cameras, and why."""
        return (
            f"{self.near + self.empty} of {self.tried} made-up cameras show too little "
            f"({self.near} have something right before them, {self.empty} see little or nothing)"
        )


class Screen:
    """Looks at a scene from anywhere."""

    def __init__(self, model: SplatModel, subject: Subject, renderer: Renderer) -> None:
        """Looks are at the finest level of `model`, of whose splats some are the subject."""
        self._subject, self._model, self._renderer = subject, model, renderer
        self._held = subject.holds(model.means, model.opacities).float()
        self._points = subject.points[:: -(-len(subject.points) // POINTS)]

    def look(self, camera: Camera) -> Sighting:
        """The sighting from a camera."""
        camera = camera.scaled(camera.width / LOOK_WIDTH)
        model, part = self._model, self._model.part(-1)
        w2c = torch.as_tensor(camera.w2c, dtype=torch.float32)
        with torch.no_grad():
            rows = model.visible(part, camera)
            means, scales = model.means[rows], model.log_scales[rows].exp()
            depth = means @ w2c[2, :3] + w2c[2, 3]
            colors = torch.stack([self._held[rows], depth, torch.zeros_like(depth)], dim=1)
            opacities, focals = model.opacities[rows], part.focals
            splats = Gaussians(means, model.quats[rows], scales, opacities, colors, focals=focals)
            rendering = self._renderer.render(splats, camera, torch.zeros(3))
        alpha, image = rendering.alpha.double().numpy(), rendering.image.double().numpy()
        depths = np.where(alpha > OPAQUE, image[..., 1] / np.maximum(alpha, OPAQUE), np.inf)
        frame = camera.framed(self._points)
        seen = frame.which.copy()
        behind = frame.depths - depths[frame.rows, frame.columns]
        seen[frame.which] = behind <= BEHIND * self._subject.radius
        return Sighting(float(image[..., 0].mean()), seen, depths)

    def _seen(self, looks: Iterable[Sighting]) -> float:
        """Share of the points that some look sees."""
        return float(np.any([look.seen for look in looks], axis=0).mean())

    def places(self) -> FreePlaces:
        """Free places among things, if they show more than a round of the scene does."""
        places, lens = free_places(self._subject), lens_of(LOOK_WIDTH)
        none = FreePlaces(places.eyes[:0], places.clear[:0])
        if len(places.eyes) == 0:
            return none
        sides = ((turn / TURNS, tilt) for tilt in TILTS for turn in range(TURNS))
        outside = self._seen(self.look(camera_at(self._subject, lens, *side)) for side in sides)
        if outside > 1 - HIDDEN:
            return none
        half = lens.width / 2
        wide = Camera(lens.width, lens.width, half, half, half, half, lens.w2c)
        looks = [cube(eye) for eye in spread(places, PLACES)]
        inside = self._seen(self.look(replace(wide, w2c=w2c)) for six in looks for w2c in six)
        return places if inside > outside else none

    def screened(self, counts: Sequence[int], width: int) -> Screened:
        """So many cameras of each set, for pictures of a width, or fewer.

        Those of the first set see all of the scene, if they stand around it.
        """
        places, lens = self.places(), lens_of(width)
        kept: list[list[Camera]] = []
        tried, near, empty, blind = 0, 0, 0, False
        for seed, count in enumerate(counts):
            if len(places.eyes):
                cameras = cameras_among(self._subject, places, count, lens, seed)
            else:
                zooms = NEARER if seed else WHOLLY
                cameras = cameras_around(self._subject, count, lens, seed, zooms)
            looks = [self.look(camera) for camera in cameras]
            limit = NEAR * usual_depth(looks)
            close = np.array([is_near(look, limit) for look in looks])
            bare = np.array([is_empty(look) for look in looks]) & ~close
            good = ~(close | bare)
            # Where none is good some are needed all the same: splats are ranked from somewhere.
            kept.append([cameras[row] for row in np.flatnonzero(good | ~good.any())])
            tried, near, empty = tried + count, near + int(close.sum()), empty + int(bare.sum())
            blind |= not good.any()
        return Screened(tuple(kept), tried, near, empty, blind)


def usual_depth(looks: Sequence[Sighting]) -> float:
    """Median over cameras of the median depth of what they see, world units; 0 if nothing."""
    there = [look.depths[np.isfinite(look.depths)] for look in looks]
    depths = [float(np.median(some)) for some in there if len(some)]
    return float(np.median(depths)) if depths else 0.0


def is_near(look: Sighting, limit: float) -> bool:
    """Something opaque is right before the camera, nearer than the limit."""
    return float((look.depths < limit).mean()) > NEAR_SHARE


def is_empty(look: Sighting) -> bool:
    """The camera sees too little of the subject."""
    return look.filled < (LITTLE if look.seen.mean() >= MUCH else FILLED)


def spread(places: FreePlaces, count: int) -> Float64:
    """Some of the places, the freest and others far from it and each other [n, 3]."""
    chosen = [int(places.clear.argmax())]
    while len(chosen) < min(count, len(places.eyes)):
        gaps = np.linalg.norm(places.eyes[:, None] - places.eyes[chosen], axis=2).min(axis=1)
        chosen.append(int(gaps.argmax()))
    return places.eyes[chosen]


def cube(place: Float64) -> list[Float64]:
    """World to camera of six looks from a place, one through each face of a cube."""
    looks: list[Float64] = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            rotation = np.roll(np.eye(3), axis, axis=1) * np.array([[1.0], [sign], [sign]])
            w2c = np.eye(4)
            w2c[:3, :3], w2c[:3, 3] = rotation, -rotation @ place
            looks.append(w2c)
    return looks
