"""Splats whose levels have opacities of their own, sent with each level (LapisGS, §6.6)."""

import zlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gsynopsis.model.splat_levels import LOGIT_MOST
from gsynopsis.model.splats import FileModel, SplatModel, SplatPart
from gsynopsis.model.tables import Decoded
from gsynopsis.scene.camera import Camera

Float32 = NDArray[np.float32]
BEST = 9
"""Level of DEFLATE."""


class LevelOpacities(SplatModel):
    """A splat model whose levels have opacities of their own."""

    of_level: dict[int, Tensor]  # by the identity of a part, [n]

    @staticmethod
    def of(model: FileModel, logits: Sequence[Float32]) -> "LevelOpacities":
        """Another model's tensors, which are not copied, with opacities by level.

        Args:
            model: With splats.
            logits: Of each level's rows, before the logistic function.
        """
        assert isinstance(model, SplatModel)
        found = LevelOpacities.__new__(LevelOpacities)
        torch.nn.Module.__init__(found)
        for name, value in model.named_buffers(recurse=False):
            found.register_buffer(name, value)
        found.parts = model.parts
        found.of_level = {
            id(part): torch.tensor(own).sigmoid().to(found.means.device)
            for part, own in zip(model.parts, logits, strict=True)
        }
        return found

    def decode_part(self, part: SplatPart, camera: Camera) -> Decoded:
        """As of a splat model."""
        decoded = super().decode_part(part, camera)
        own = self.of_level[id(part)].to(decoded.anchors.device)[decoded.anchors]
        return Decoded(
            replace(decoded.gaussians, opacities=own), decoded.anchors, decoded.slots, own[:, None]
        )


def opacity_columns(
    logits: Sequence[Float32], order: NDArray[np.int64], step: float
) -> tuple[list[Float32], tuple[int, ...]]:
    """Rounded opacities of each level in a file's order, and the bytes that each level adds.

    A level sends its own rows' opacities in the file and, beside it, a byte column by DEFLATE: for
    each row of the levels before, by how many steps it differs from what they have.

    Args:
        logits: Of each level, coarsest first, before the logistic function.
        order: For each row of the file the place in `logits`.
        step: Of rounding.
    """
    held = np.zeros(0, np.int64)
    columns, extra = list[Float32](), list[int]()
    for own in logits:
        wanted = np.rint(np.clip(own[order[: len(own)]], -LOGIT_MOST, LOGIT_MOST) / step)
        wanted = wanted.astype(np.int64)
        change = np.clip(wanted[: len(held)] - held, -128, 127)
        held = np.concatenate([held + change, wanted[len(held) :]])
        extra.append(
            len(zlib.compress(change.astype(np.int8).tobytes(), BEST)) if len(change) else 0
        )
        columns.append((held * step).astype(np.float32))
    return columns, tuple(extra)
