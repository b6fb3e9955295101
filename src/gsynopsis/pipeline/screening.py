"""Cameras for Gaussians without photos that see something: what is hidden, near, or not there."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from gsynopsis.model.splats import SplatModel
from gsynopsis.pipeline.around import (
    NEARER,
    WHOLLY,
    Float64,
    Places,
    Subject,
    camera_at,
    cameras_among,
    cameras_around,
    free_places,
    lens_of,
)
from gsynopsis.render.base import DILATION, Gaussians, Renderer, focal_length
from gsynopsis.scene.camera import Camera

LOOK_WIDTH = 240
"""Of pictures that say what a camera sees, pixels."""
SPARE = 1.5
"""So many times the cameras that are needed are tried."""
DROPPED = 1 / 3
"""A larger share of dropped cameras says that those left tell little of the scene."""
OPAQUE = 0.5
"""Alpha from which on something is there."""
NEAR, NEAR_SHARE = 0.15, 0.25
"""Of the usual depth; of a picture that shows what is nearer, the largest share."""
FILLED, LITTLE = 0.1, 0.01
"""Least share of a picture that shows the subject: alone, and where much of it is seen."""
MUCH = 0.1
"""Share of the subject that is much."""
HIDDEN_TILTS, HIDDEN_TURNS = (-0.6, -0.15, 0.15, 0.6), 5
"""Of cameras around, radians, and sides: none looks in from high above, as many a room is open."""
SEEN = 0.1
"""Share of a splat's face that is not hidden, from which on it is seen."""
BEHIND = 0.03
"""Of the radius: what is no farther behind a surface is part of it, as splats lie in layers."""
HIDDEN, PLACES = 0.13, 8
"""Share that is hidden from around, from which on places among things, so many, may show more."""


@dataclass(frozen=True)
class Look:
    """What a camera sees, in a small picture.

    Attributes:
        filled: Share of the picture that shows the subject.
        seen: Splats of the subject that are seen, ascending [n].
        depths: Of each pixel, world units, infinite where nothing is [H, W].
    """

    filled: float
    seen: NDArray[np.int64]
    depths: Float64


@dataclass(frozen=True)
class Screened:
    """Cameras that see something, or others where none does.

    Attributes:
        cameras: Of each set that was asked for.
        tried: How many there were of all sets.
        near: Of these, dropped as something opaque is right before them.
        empty: Dropped as they see too little.
    """

    cameras: tuple[list[Camera], ...]
    tried: int
    near: int
    empty: int

    @property
    def trusted(self) -> bool:
        """That few enough were dropped for figures that are measured from the rest."""
        return self.near + self.empty <= DROPPED * self.tried

    def __str__(self) -> str:
        """What was dropped, and why."""
        return (
            f"{self.near + self.empty} of {self.tried} made-up cameras show too little "
            f"({self.near} have something right before them, {self.empty} see little or nothing)"
        )


class Screen:
    """Looks at a scene from anywhere."""

    def __init__(self, model: SplatModel, subject: Subject, renderer: Renderer) -> None:
        """Looks are at the finest level of `model`, of whose splats some are the subject."""
        self.subject, self._model, self._renderer = subject, model, renderer
        held = subject.holds(model.means, model.opacities)
        self._held, self._count = held, max(1, int(held.sum()))

    def look(self, camera: Camera) -> Look:
        """What a camera sees."""
        camera = camera.scaled(camera.width / LOOK_WIDTH)
        model, part = self._model, self._model.part(-1)
        w2c = torch.as_tensor(camera.w2c, dtype=torch.float32)
        rows = model.visible(part, camera)
        means, scales = model.means[rows], model.log_scales[rows].exp()
        depth, held = means @ w2c[2, :3] + w2c[2, 3], self._held[rows]
        colors = torch.stack([held.float(), depth, torch.zeros_like(depth)], dim=1)
        splats = Gaussians(
            means, model.quats[rows], scales, model.opacities[rows], colors, focals=part.focals
        )
        # A picture is linear in its colours: the slope of its sum is what a splat fills of it.
        with torch.enable_grad():
            colors.requires_grad_(True)
            rendering = self._renderer.render(splats, camera, torch.zeros(3))
            (fills,) = torch.autograd.grad(rendering.image[..., 0].sum(), colors)
        alpha = rendering.alpha.double().numpy()
        image = rendering.image.detach().double().numpy()
        depths = np.where(alpha > OPAQUE, image[..., 1] / np.maximum(alpha, OPAQUE), np.inf)
        faces = scales.sort(dim=1).values[:, 1:] * (focal_length(camera) / depth)[:, None]
        most = 2 * math.pi * splats.opacities * (faces.square() + DILATION).prod(dim=1).sqrt()
        seen = fills[:, 0] > SEEN * most
        frame = camera.framed(means.double().numpy())
        behind = frame.depths - depths[frame.rows, frame.columns]
        seen[np.flatnonzero(frame.which)[behind <= BEHIND * self.subject.radius]] = True
        seen &= held
        return Look(float(image[..., 0].mean()), rows[seen].numpy(), depths)

    def seen(self, looks: Iterable[Look]) -> NDArray[np.bool_]:
        """Splats of the subject that some look sees, bool [N]."""
        seen = np.zeros(len(self._model), bool)
        for look in looks:
            seen[look.seen] = True
        return seen

    def places(self) -> Places:
        """Free places among things, if they show more than a round of the scene does."""
        places, lens = free_places(self.subject), lens_of(LOOK_WIDTH)
        none = Places(places.eyes[:0], places.clear[:0])
        if len(places.eyes) == 0:
            return none
        sides = (
            (turn / HIDDEN_TURNS, tilt) for tilt in HIDDEN_TILTS for turn in range(HIDDEN_TURNS)
        )
        outside = self.seen(self.look(camera_at(self.subject, lens, *side)) for side in sides)
        if outside.sum() > (1 - HIDDEN) * self._count:
            return none
        half = lens.width / 2
        wide = Camera(lens.width, lens.width, half, half, half, half, lens.w2c)
        chosen = spread(places, PLACES)
        inside = self.seen(self.look(replace(wide, w2c=w2c)) for eye in chosen for w2c in cube(eye))
        return places if inside.sum() > outside.sum() else none

    def screened(self, counts: Sequence[int], width: int) -> Screened:
        """So many cameras of each set, for pictures of a width, or fewer.

        Those of the first set see all of the scene, if they stand around it.
        """
        places, lens = self.places(), lens_of(width)
        sets: list[list[Camera]] = []
        for seed, count in enumerate(counts):
            tries = round(SPARE * count)
            if len(places.eyes):
                sets.append(cameras_among(self.subject, places, tries, lens, seed))
            else:
                zooms = NEARER if seed else WHOLLY
                sets.append(cameras_around(self.subject, tries, lens, seed, zooms))
        looks = [[self.look(camera) for camera in cameras] for cameras in sets]
        every = [look for some in looks for look in some]
        limit = NEAR * usual_depth(every)
        near = [[is_near(look, limit) for look in some] for some in looks]
        empty = [[self._is_empty(look) for look in some] for some in looks]
        kept: list[list[Camera]] = []
        for number, count in enumerate(counts):
            bad = np.array(near[number]) | np.array(empty[number])
            rows = np.flatnonzero(~bad if not bad.all() else bad)
            some = rows[np.arange(min(count, len(rows))) * len(rows) // min(count, len(rows))]
            kept.append([sets[number][row] for row in some])
        close, bare = np.concatenate(near), np.concatenate(empty)
        return Screened(tuple(kept), len(every), int(close.sum()), int((bare & ~close).sum()))

    def _is_empty(self, look: Look) -> bool:
        """The camera sees too little of the subject."""
        much = len(look.seen) >= MUCH * self._count
        return look.filled < (LITTLE if much else FILLED)


def usual_depth(looks: Sequence[Look]) -> float:
    """Median over cameras of the median depth of what they see, world units; 0 if nothing."""
    there = [look.depths[np.isfinite(look.depths)] for look in looks]
    depths = [float(np.median(some)) for some in there if len(some)]
    return float(np.median(depths)) if depths else 0.0


def is_near(look: Look, limit: float) -> bool:
    """Something opaque is right before the camera, nearer than the limit."""
    return float((look.depths < limit).mean()) > NEAR_SHARE


def spread(places: Places, count: int) -> Float64:
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
