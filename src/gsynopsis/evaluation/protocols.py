"""Interfaces of the evaluator: a decoder, a scene, and its options."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from gsynopsis.evaluation.metrics import Image8, LearntMeasure, to_bytes
from gsynopsis.evaluation.report import Provenance
from gsynopsis.render.base import Gaussians, Renderer
from gsynopsis.render.supersampling import render_reduced
from gsynopsis.scene.account import Account
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


class Named(Protocol):
    """A view; the evaluator needs only its name."""

    @property
    def name(self) -> str:
        """File name of the photo."""
        ...


class Photos(Protocol):
    """Scene of an evaluation; a `scene.Scene` is one."""

    @property
    def name(self) -> str:
        """Name of the scene."""
        ...

    @property
    def views(self) -> Sequence[Named]:
        """All views."""
        ...

    @property
    def train(self) -> Sequence[int]:
        """Indices of the views to train on."""
        ...

    @property
    def test(self) -> Sequence[int]:
        """Indices of the held-out views."""
        ...

    @property
    def notes(self) -> Sequence[str]:
        """Oddities in how the scene was read, for readers of the results."""
        ...

    @property
    def account(self) -> Account:
        """Account of the scene's folder: files used, and files that are not."""
        ...

    def camera(self, view: int, factor: float, /) -> Camera:
        """The camera of a view whose photo is divided by `factor`."""
        ...

    def image(self, view: int, factor: float, /) -> Image8:
        """The photo of a view divided by `factor`, uint8 [H, W, 3]."""
        ...

    def fingerprint(self) -> str:
        """A digest that tells scenes apart."""
        ...


@dataclass(frozen=True)
class Options:
    """Options of an evaluation.

    Attributes:
        frames: Frames to time per level, at least 1 (methods.md §3.5 asks for 200 on a GPU).
        warmup: Frames before those, not counted.
        pictures: Views kept as images, spread evenly over the held-out ones.
        background: RGB behind everything, [0, 1]; black as in training.
        pyramid: Method by which the scene makes photos smaller; copied into the report.
        provenance: Origin of the file; copied into the report.
        lpips: A learnt measure, or None.
        tick: Called after each view with the views done and the views in all; then again for the
            views at the photos' own size, and for training views.
        photo_pixels: Most pixels to render at the photos' own size, over all views and levels; of
            more views as many as fit, evenly apart, at least one. 0 leaves these figures out.
        inside: Gives the pixels of a view inside its mask, [H, W], for its photo divided by a
            factor; None: no masks.
        exposure: Measure also after the photos' exposure was removed.
    """

    frames: int = 20
    warmup: int = 3
    pictures: int = 3
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pyramid: str = "Lanczos in 8 bits, each size from the stored photo, never from a smaller copy"
    provenance: Provenance = field(default_factory=Provenance)
    lpips: LearntMeasure | None = None
    tick: Callable[[int, int], None] | None = None
    photo_pixels: int = 0
    inside: Callable[[int, float], NDArray[np.bool_] | None] | None = None
    exposure: bool = False


class LevelRenderer:
    """Decoder, renderer and background: a camera and a level in, an 8-bit image out."""

    def __init__(self, decoder: Decoder, renderer: Renderer, background: Tensor) -> None:
        """All tensors on the renderer's device; background is [3]."""
        self.decoder, self.renderer, self.background = decoder, renderer, background

    def paint(self, camera: Camera, level: int) -> Image8:
        """The image as a saved PNG would hold it."""
        gaussians = self.decoder.decode(camera, level)
        return to_bytes(render_reduced(self.renderer, gaussians, camera, self.background))
