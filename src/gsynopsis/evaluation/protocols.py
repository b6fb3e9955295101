"""The evaluator's decoder, its options, and images of both."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import torch
from torch import Tensor

from gsynopsis.evaluation.metrics import Image8, LearntMeasure, to_bytes
from gsynopsis.evaluation.report import Provenance
from gsynopsis.render.base import Gaussians, Renderer
from gsynopsis.render.supersampling import render_reduced
from gsynopsis.scene.camera import Camera
from gsynopsis.stream.views import ViewPose


def eye_of(camera: Camera) -> ViewPose:
    """A camera as a streaming policy sees it."""
    c = camera
    return ViewPose(c.w2c, c.width / 2 / c.fx, c.height / 2 / c.fy)


class Decoder(Protocol):
    """Whatever turns a camera and a level into Gaussians; an `AnchorModel` is one."""

    def decode(self, camera: Camera, level: int) -> Gaussians:
        """The Gaussians of `level` as seen from `camera`, on the renderer's device."""
        ...


@dataclass(frozen=True)
class Options:
    """Options of an evaluation.

    Attributes:
        frames: Frames to time per level, at least 1 (methods.md §3.5 asks for 200 on a GPU).
        warmup: Frames before those, not counted.
        pictures: Views kept as images, spread evenly over the held-out ones.
        provenance: Origin of the file; copied into the report.
        lpips: A learnt measure, or None.
        tick: Called after each view with the views done and the views in all; then again for the
            views at the photos' own size, and for training views.
        photo_pixels: Most pixels to render at the photos' own size, over all views and levels; of
            more views as many as fit, evenly apart, at least one. 0 leaves these figures out.
        exposure: Measure also after the photos' exposure was removed.
    """

    frames: int = 20
    warmup: int = 3
    pictures: int = 3
    provenance: Provenance = field(default_factory=Provenance)
    lpips: LearntMeasure | None = None
    tick: Callable[[int, int], None] | None = None
    photo_pixels: int = 0
    exposure: bool = False


class LevelRenderer:
    """Decoder, renderer and background: a camera and a level in, an 8-bit image out."""

    def __init__(
        self, decoder: Decoder, renderer: Renderer, background: Tensor | None = None
    ) -> None:
        """All tensors on the renderer's device; background is [3], None black."""
        if background is None:
            background = torch.zeros(3, device=renderer.device)
        self.decoder, self.renderer, self.background = decoder, renderer, background

    def paint(self, camera: Camera, level: int) -> Image8:
        """The image as a saved PNG would hold it."""
        gaussians = self.decoder.decode(camera, level)
        return to_bytes(render_reduced(self.renderer, gaussians, camera, self.background))
