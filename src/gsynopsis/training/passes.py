"""Decoding and rendering of one view with gradients: by native kernels in order, or by autograd.

Both give the same bits where the native kernels apply. The road is chosen once, when a training
gets its model; a step then reads alike on either.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol, TypeAlias

from torch import Tensor

from gsynopsis.model.anchors import AnchorModel, LearntMask, LevelPart
from gsynopsis.model.tables import Decoded
from gsynopsis.render.base import Renderer, Rendering
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import Camera


class ViewPass(Protocol):
    """One view of one level, decoded; `decoded` has gradients for a loss of its own."""

    decoded: Decoded

    def render(self, dropout: Tensor | None, background: Tensor) -> Rendering:
        """The image, attached to a loss.

        Args:
            dropout: Factors on the opacities, [G]; None: ones.
            background: Color behind everything, [3].
        """
        ...

    def backward(self, loss: Tensor) -> None:
        """Add the gradients of a loss of `decoded` and the image to the model's parameters."""
        ...


MakePass: TypeAlias = Callable[[AnchorModel, Renderer, LevelPart, Camera], ViewPass]
"""Decodes a part of a model for a camera, ready to be rendered."""


def choose_pass(renderer: Renderer, model: AnchorModel) -> MakePass:
    """Native passes on the CPU where kernels decode every part; else autograd."""
    native = isinstance(renderer, CpuRenderer) and all(map(model.is_native, model.level_parts()))
    return AnchorModel.native_pass if native else AutogradPass


class AutogradPass:
    """A view by autograd; the only road for masks that are learnt, and on a GPU."""

    def __init__(
        self,
        model: AnchorModel,
        renderer: Renderer,
        part: LevelPart,
        camera: Camera,
        mask: LearntMask | None = None,
    ) -> None:
        """Decode, with a mask that is learnt if there is one."""
        self.renderer, self.camera = renderer, camera
        self.decoded = model.decode_part(part, camera, mask)

    def render(self, dropout: Tensor | None, background: Tensor) -> Rendering:
        """See `ViewPass.render`."""
        gaussians = self.decoded.gaussians
        if dropout is not None:
            gaussians = replace(gaussians, opacities=gaussians.opacities * dropout)
        return self.renderer.render(gaussians, self.camera, background)

    def backward(self, loss: Tensor) -> None:
        """See `ViewPass.backward`."""
        if loss.requires_grad:  # nothing adapts while ablation `base` warms up
            loss.backward()
