"""Contract between training and a device that does whole steps, while the host's tensors wait."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from gsynopsis.model.anchors import AnchorModel, LevelPart
from gsynopsis.scene.camera import Camera, Shift
from gsynopsis.training.optim.adam import Optimizer

Sums: TypeAlias = Callable[[], tuple[Tensor, Tensor]]
"""Sums of a photo and of its rendering over what counts, [3] each; see `Exposures.move`."""


@dataclass(frozen=True)
class ViewJob:
    """One view of one level, to be trained wholly on a device.

    Attributes:
        model: Its parameters may be newer on the device.
        part: Level to decode.
        camera: Of the view, at the training resolution.
        photo: View, factor and shift, which name the photo.
        pixels: Decodes it, uint8 [H, W, 3].
        behind: Decodes what shows through it of the background, a grey to be added to all three
            colors, uint8 [H, W]; None: nothing does.
        mask: Decodes the photo's mask, float32 [H, W] in [0, 1], and gives the share of it that
            counts; None: all of it.
        gains: The photo's gains once the sums are known that they are solved by, see `Sums`; None:
            photos have none.
        background: Color behind everything.
        weight: Factor on the loss.
        volume: λ on the mean product of scales.
        opacity: λ on the mean opacity.
        dropout: Share of Gaussians left out, and which of so many are not, bool; None: all are
            drawn.
        counters: Growth statistics to count the view in, by name in order; None: it is not counted.
    """

    model: AnchorModel
    part: LevelPart
    camera: Camera
    photo: tuple[int, float, Shift]
    pixels: Callable[[], Any]
    behind: Callable[[], Any] | None
    mask: Callable[[], tuple[Any, float]] | None
    gains: Callable[[Sums], tuple[float, float, float]] | None
    background: tuple[float, float, float]
    weight: float
    volume: float
    opacity: float
    dropout: tuple[float, Callable[[int], NDArray[np.bool_]]] | None
    counters: Mapping[str, Tensor] | None


class WholeStep(Protocol):
    """Training steps on a device that keeps the parameters until they are asked for."""

    def train_view(self, job: ViewJob) -> Tensor:
        """Forward and backward pass of one view; gradients add up on the device.

        Returns:
            Loss and squared error, float64 [2], which `settle` fills in.

        Raises:
            SceneError: the pixel data cannot be decoded.
            SpaceError: the device has no buffer of that size.
        """
        ...

    def gradient(self, parameter: Tensor) -> Tensor | None:
        """A copy of the gradient that a parameter has so far; None: it has none."""
        ...

    def move(self, optimizer: Optimizer, views: int) -> None:
        """One step of Adam by the gradients' mean over so many views; they are dropped."""
        ...

    def average(self, optimizer: Optimizer, share: float) -> None:
        """See `Optimizer.average`."""
        ...

    def settle(self) -> None:
        """Read the losses of all views so far."""
        ...

    def home(self) -> None:
        """Give the host's tensors the device's values, before anything reads or changes them."""
        ...
