"""Dropout of Gaussians: each image of a step lacks some at random (methods.md §2.17).

With few photos, each is soon fit by Gaussians of its own, which other views see as floaters. The
Gaussians that replace the dropped ones must fit all photos. After H. Park, G. Ryu and W. Kim,
"DropGaussian: Structural Regularization for Sparse-view Gaussian Splatting", CVPR 2025.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gsynopsis.render.base import sent


def drawn_lots(count: int, share: float, key: tuple[int, ...]) -> NDArray[np.bool_]:
    """False for what is left out, bool [count]; see `dropout_factors`."""
    return np.random.default_rng(key).random(count, np.float32) >= share


def dropout_factors(opacities: Tensor, share: float, key: tuple[int, ...]) -> Tensor:
    """Factors on opacities of an image's Gaussians, float32 [G]: 0 leaves a Gaussian out.

    The others are opaquer by 1 / (1 - share), up to an opacity of 1, so that the image is about as
    opaque. For gradients of the opacities the factors are constants.

    Args:
        opacities: Of the Gaussians, [G] in [0, 1].
        share: How many are left out on average, in [0, 1).
        key: Of the step and view, each ≥ 0; the same one gives the same factors.
    """
    with torch.no_grad():
        kept = sent(torch.from_numpy(drawn_lots(len(opacities), share, key)), opacities.device)
        return kept * (opacities.clamp(min=1e-12).reciprocal()).clamp(max=1 / (1 - share))
