"""Small pictures of a scene that say how well a camera there would do (ours).

A trained scene looks right from where it was photographed: splats are as many pixels across near
by as far away, surfaces are opaque, and nothing hangs before the camera.
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from gsynopsis.cameras.placement import Subject, shown
from gsynopsis.cameras.view_dependence import color_change, every
from gsynopsis.formats.readers.base import rows_of
from gsynopsis.model.splats import SplatModel
from gsynopsis.records import PlainGaussians
from gsynopsis.render.base import ANTIALIASED, Gaussians, Renderer
from gsynopsis.scene.camera import Camera

Float64 = NDArray[np.float64]
DRAWN = 30_000
"""Splats that stand for all in small pictures."""
SKETCH_WIDTH = 96
"""Width of those images, pixels."""
OPAQUE = 0.5
"""Alpha from which on something is there."""
POINTS = 4096
"""Points of a subject that are looked for, about."""
NEAR = 0.3
"""Share of the distance to the target: what is nearer stands in the way, or is fog."""
COARSE = 1.2
"""Logarithm of the factor by which splats look larger where a picture looks wrong."""
BEHIND = 0.03
"""Share of its depth: a point no farther behind a surface is seen with it; splats lie in layers."""
AROUND, FILLING, BACKDROP = 1.5, 1.0, 1024
"""Radii from which on something is what is around; how much of a sphere's 4π it fills, splat by
splat, to count; and places of it that are looked for."""
LAYERS = 0.1
"""Share of the subject's radius: what is no farther behind a surface is part of the same thing."""


def thinned(gaussians: PlainGaussians, most: int = DRAWN) -> PlainGaussians:
    """Fewer splats that cover what all do: drawn by what they show, those drawn made larger.

    A splat is kept with a chance that grows as the root of opacity times area, and its area is
    divided by that chance, so that what covers a surface still does on average.
    """
    if len(gaussians) <= most:
        return rows_of(gaussians, slice(None))
    worth = np.sqrt(shown(gaussians))
    worth /= max(float(worth.max()), 1e-300)
    low, high = 0.0, most / max(float(worth.sum()), 1e-300) * 1e3
    for _ in range(60):
        factor = (low + high) / 2
        low, high = (factor, high) if np.minimum(1, factor * worth).sum() < most else (low, factor)
    chance = np.minimum(1, high * worth)
    rows = np.flatnonzero(np.random.default_rng(0).random(len(worth)) < chance)
    kept = rows_of(gaussians, rows)
    larger = (-0.5 * np.log(chance[rows]))[:, None].astype(np.float32)
    return PlainGaussians(
        kept.means, kept.log_scales + larger, kept.quaternions, kept.logits, kept.sh[:, :1]
    )


@dataclass(frozen=True)
class Sight:
    """A small picture from a camera, in numbers.

    Attributes:
        seen: Points of the subject that are seen, bool [P].
        backdrop: Places of what is around that are seen, bool [B].
        reached: Those points and what is behind, no farther than splats of one thing lie, bool [P].
        framed: Share of the points that are in the picture, hidden or not.
        sizes: Logarithm of the angle of those points' splats, their standard deviation [n].
        depth: Median over the picture, world units; infinite where it is empty.
        filled: Mean opacity of the picture.
        aside: Distance of what is in it, on the mean, from its middle; half a side is 1.
        opaque: Something in it is.
        near: Share that shows what is much nearer than the rest, or fog.
        uneven: Spread over the picture of the logarithm of splats' angles.
        angle: Median over the picture of the logarithm of splats' angles.
        coarse: Share of the picture whose splats are more than `COARSE` above that.
        change: Of the seen points' colors from here, see `color_change`.
    """

    seen: NDArray[np.bool_]
    backdrop: NDArray[np.bool_]
    reached: NDArray[np.bool_]
    framed: float
    sizes: Float64
    depth: float
    filled: float
    aside: float
    opaque: bool
    near: float
    uneven: float
    angle: float
    coarse: float
    change: float


class Sketcher:
    """Draws a scene small, from anywhere."""

    def __init__(self, gaussians: PlainGaussians, subject: Subject, renderer: Renderer) -> None:
        """Draws all of `gaussians`, which may be `thinned` ones; `subject` is of the same scene."""
        self._model, self._renderer = SplatModel(gaussians), renderer
        scales = self._model.log_scales.sort(dim=1).values
        self._size = (scales[:, 1] + scales[:, 2]) / 2
        self._radius, self._middle = subject.radius, subject.middle
        step = -(-len(subject.points) // POINTS)
        self.points, self._sizes = subject.points[::step], np.log(subject.sizes[::step])
        self._harmonics = subject.harmonics[::step]
        self.backdrop = _backdrop(gaussians, subject)

    def look(self, camera: Camera, distance: float) -> Sight:
        """The sight from a camera, of what is about so far away, world units."""
        camera = camera.scaled(camera.width / SKETCH_WIDTH)
        model = self._model
        w2c = torch.as_tensor(camera.w2c, dtype=torch.float32)
        with torch.no_grad():
            rows = model.visible(model.part(-1), camera)
            means = model.means[rows]
            depth = means @ w2c[2, :3] + w2c[2, 3]
            angle = self._size[rows] - depth.clamp(min=1e-9).log()
            near = (depth < NEAR * min(distance, self._radius)).float()
            colors = torch.stack([depth, angle, near], dim=1)
            splats = Gaussians(
                means,
                model.quats[rows],
                model.log_scales[rows].exp(),
                model.opacities[rows],
                colors,
                focals=ANTIALIASED,
            )
            rendering = self._renderer.render(splats, camera, torch.zeros(3))
        alpha, image = rendering.alpha.double().numpy(), rendering.image.double().numpy()
        return self._sight(camera, alpha, image)

    def _sight(self, camera: Camera, alpha: Float64, image: Float64) -> Sight:
        there = alpha > OPAQUE
        depths = np.where(there, image[..., 0] / np.maximum(alpha, OPAQUE), np.inf)
        angles = (image[..., 1] / np.maximum(alpha, OPAQUE))[there]
        frame = camera.framed(self.points)
        seen, reached, here = (
            frame.which.copy(),
            frame.which.copy(),
            depths[frame.rows, frame.columns],
        )
        seen[frame.which] = frame.depths <= (1 + BEHIND) * here
        reached[frame.which] = frame.depths <= here + LAYERS * self._radius
        local = (self.points[seen] @ camera.w2c[2, :3]) + camera.w2c[2, 3]
        low, middle, high = np.quantile(angles, [0.16, 0.5, 0.84]) if len(angles) else (0, 0, 0)
        rows = np.flatnonzero(seen)
        rows = rows[every(len(rows))]
        return Sight(
            seen,
            self._backdrop_seen(camera, depths),
            reached,
            float(frame.which.mean()),
            self._sizes[seen] - np.log(local),
            float(np.median(depths)),
            float(alpha.mean()),
            _aside(alpha),
            bool(there.any()),
            float(image[..., 2].mean()),
            float(high - low) / 2,
            float(middle),
            float((angles > middle + COARSE).mean()) if len(angles) else 0.0,
            color_change(self._harmonics[rows], self.points[rows] - camera.position),
        )

    def _backdrop_seen(self, camera: Camera, depths: Float64) -> NDArray[np.bool_]:
        frame = camera.framed(self.backdrop)
        seen = frame.which.copy()
        # What is far is thick, and nothing stands behind it.
        seen[frame.which] = frame.depths <= 2 * depths[frame.rows, frame.columns]
        # It is around: from behind, or from outside, nobody photographed it.
        outwards = self.backdrop - self._middle
        return seen & (((self.backdrop - camera.position) * outwards).sum(axis=1) > 0)


def _aside(alpha: Float64) -> float:
    """Distance of the mean place of opacity from the middle; half the width or height is 1."""
    total = float(alpha.sum())
    if total <= 0:
        return 0.0
    y, x = (np.linspace(-1, 1, count) for count in alpha.shape)
    return float(np.hypot(alpha.sum(axis=0) @ x, alpha.sum(axis=1) @ y)) / total


def _backdrop(gaussians: PlainGaussians, subject: Subject) -> Float64:
    """Places of splats outside a subject, drawn by how much of a look around each fills [B, 3].

    None where these fill little of it.
    """
    means = gaussians.means.astype(np.float64)
    away = np.linalg.norm(means - subject.middle, axis=1)
    filling = shown(gaussians) / np.maximum(away, subject.radius) ** 2
    filling[away < AROUND * subject.radius] = 0
    if filling.sum() < FILLING:
        return means[:0]
    chance = np.random.default_rng(0)
    return means[chance.choice(len(means), BACKDROP, p=filling / filling.sum())]
