"""Plain Gaussians as a model whose values can be learnt.

Letters: G Gaussians, C coefficients of the spherical harmonics (1, 4, 9 or 16).
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from gsynopsis.model.harmonics import harmonic_colors
from gsynopsis.records import PlainGaussians
from gsynopsis.render.base import ANTIALIASED, Gaussians
from gsynopsis.scene.camera import Camera


class PlainModel(nn.Module):
    """Plain Gaussians whose values can be learnt, as one level or several nested ones."""

    def __init__(
        self, gaussians: PlainGaussians, *, antialiased: bool, counts: Sequence[int] = ()
    ) -> None:
        """Takes a copy of the arrays.

        Args:
            gaussians: May be none.
            antialiased: Render with `ANTIALIASED`; else as in 3DGS.
            counts: Gaussians of each level, the first ones, coarsest level first; none: they are
                one level, whichever is asked for.
        """
        super().__init__()
        self.counts = tuple(counts)
        self.focals = ANTIALIASED if antialiased else None
        self.means = _parameter(gaussians.means)
        self.log_scales = _parameter(gaussians.log_scales)
        self.quaternions = _parameter(gaussians.quaternions)
        self.logits = _parameter(gaussians.logits)
        self.base = _parameter(gaussians.sh[:, :1])  # [G, 1, 3]
        self.rest = _parameter(gaussians.sh[:, 1:])  # [G, C - 1, 3]

    def decode(self, camera: Camera, level: int = -1) -> Gaussians:
        """The Gaussians of a level, with the colours that a camera sees."""
        count = self.counts[level] if self.counts else len(self.means)

        def own(values: Tensor) -> Tensor:
            return values if count == len(values) else values[:count]

        means = own(self.means)
        eye = torch.as_tensor(camera.position, dtype=means.dtype, device=means.device)
        sh = own(self.base)
        if self.rest.shape[1]:
            sh = torch.cat([sh, own(self.rest)], dim=1)
        # Positions do not move for the sake of their colours (3DGS lets them, to no gain here).
        colors = harmonic_colors(sh, means.detach() - eye)
        return Gaussians(
            means,
            own(self.quaternions),
            own(self.log_scales).exp(),
            own(self.logits).sigmoid(),
            colors,
            focals=self.focals,
        )

    def gaussians(self) -> PlainGaussians:
        """The values as they are now."""
        sh = torch.cat([self.base, self.rest], dim=1)
        values = (self.means, self.log_scales, self.quaternions, self.logits, sh)
        return PlainGaussians(*(v.detach().cpu().numpy().astype(np.float32) for v in values))


def _parameter(values: np.ndarray) -> nn.Parameter:
    return nn.Parameter(torch.from_numpy(np.array(values, np.float32, copy=True)))
