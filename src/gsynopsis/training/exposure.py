"""An affine colour for each training photo, learnt beside the model and left out of the file.

Renderings are multiplied by a photo's 3 × 3 matrix and shifted before they are compared with it,
as 3DGS does. The mean over all photos stays the identity, so the model keeps the mean exposure.
"""

from collections.abc import Mapping

import torch
from torch import Tensor

from gsynopsis.scene.exposure import log_gains
from gsynopsis.scene.scene import Scene

RATE = 2e-3
"""Step of Adam on all numbers (ours; 3DGS: 1e-2 falling to 1e-3, from the identity)."""
BETAS = (0.9, 0.999)
EPSILON = 1e-15
SATURATED = 254.5 / 255
"""From here on a photo's value may have been cut off (ours)."""


class Exposures:
    """One affine colour per training photo, [V, 3, 4], with an Adam of its own for each."""

    def __init__(self, tensors: Mapping[str, Tensor], views: tuple[int, ...]) -> None:
        """As `tensors` gives them.

        Args:
            tensors: Matrices and moments by name.
            views: The training photos, in the order of the rows.
        """
        self.matrices = tensors["matrices"]  # [V, 3, 4]
        self.first, self.second = tensors["first"], tensors["second"]  # [V, 3, 4]
        # Learning asks for these numbers, and a host that asks a GPU has to wait.
        self.visits = tensors["visits"].cpu()  # [V]
        self._row = {view: row for row, view in enumerate(views)}
        self._used: tuple[int, Tensor] | None = None

    @classmethod
    def measured(cls, scene: Scene, device: torch.device) -> "Exposures":
        """Those that the photos themselves show at the sparse points: gains, and nothing else."""
        gains = torch.from_numpy(log_gains(scene, scene.train)).exp().float()
        matrices = torch.zeros(len(scene.train), 3, 4)
        matrices[:, range(3), range(3)] = gains
        tensors = {
            "matrices": matrices,
            "first": torch.zeros_like(matrices),
            "second": torch.zeros_like(matrices),
            "visits": torch.zeros(len(scene.train)),
        }
        exposures = cls({name: t.to(device) for name, t in tensors.items()}, scene.train)
        exposures.center()
        return exposures

    def tensors(self) -> dict[str, Tensor]:
        """All state by name, for a checkpoint."""
        names = ("matrices", "first", "second", "visits")
        return {name: getattr(self, name) for name in names}

    def applied(self, image: Tensor, view: int) -> Tensor:
        """A rendering [H, W, 3] as the photo's exposure would have it; remembered for `learn`."""
        row = self._row.get(view)
        if row is None:
            return image
        matrix = self.matrices[row].clone().requires_grad_(torch.is_grad_enabled())
        self._used = (row, matrix)
        return image @ matrix[:, :3].T + matrix[:, 3]

    def learn(self) -> None:
        """A step of Adam on the photo that was rendered last, by the gradient it was given."""
        if self._used is None or self._used[1].grad is None:
            return
        (row, matrix), self._used = self._used, None
        gradient = matrix.grad
        assert gradient is not None
        self.visits[row] += 1
        for moment, beta, value in zip(
            (self.first, self.second), BETAS, (gradient, gradient.square()), strict=True
        ):
            moment[row].lerp_(value, 1 - beta)
        count = float(self.visits[row])
        mean = self.first[row] / (1 - BETAS[0] ** count)
        scale = (self.second[row] / (1 - BETAS[1] ** count)).sqrt() + EPSILON
        self.matrices[row] -= RATE * mean / scale
        self.center()

    def center(self) -> None:
        """Shift all so that their mean is the identity again."""
        identity = torch.eye(3, 4, device=self.matrices.device)
        self.matrices += identity - self.matrices.mean(dim=0)


def unsaturated(image: Tensor, target: Tensor) -> Tensor:
    """A rendering with the photo's values where that is white and the rendering brighter.

    A saturated value says that the scene was at least as bright, and no more.

    Args:
        image: In the photo's exposure, [H, W, 3].
        target: The photo, [H, W, 3] in [0, 1].
    """
    return torch.where((target >= SATURATED) & (image > target), target, image)
