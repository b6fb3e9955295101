"""A gain per training photo and channel, solved beside the model and left out of the file.

Renderings are multiplied by a photo's three gains before they are compared with it. Their mean over
all photos stays 1, so the model keeps the mean exposure. 3DGS descends the gradient of a 3 × 4
matrix instead (1e-2 falling to 1e-3), which takes a hundred visits of each photo; the gain that
makes a rendering as bright as its photo is known in closed form at each visit.
"""

from collections.abc import Mapping

import torch
from torch import Tensor

WARM_UP = 0.1
"""Share of the full model's steps before gains are solved: until then renderings say little."""
MEMORY = 0.2
"""Least weight of a visit's gain; earlier ones count for the rest (ours)."""
PRIOR = 0.005
"""Weight of a gain of 1, in images: pulls to the identity what shows little (ours)."""
LIMIT = 4.0
"""Largest gain and inverse of the least one: two stops."""
SATURATED = 254.5 / 255
"""From here on a photo's value may have been cut off (ours)."""


class Exposures:
    """Gains of the training photos, [V, 3]."""

    def __init__(self, tensors: Mapping[str, Tensor], views: tuple[int, ...]) -> None:
        """As `tensors` gives them.

        Args:
            tensors: `log_gains` and `visits` by name.
            views: The training photos, in the order of the rows.
        """
        self.log_gains = tensors["log_gains"]  # [V, 3]
        # Read at each visit, and a host that asks a GPU has to wait.
        self.visits = tensors["visits"].cpu()  # [V]
        self._row = {view: row for row, view in enumerate(views)}

    @classmethod
    def identity(cls, views: tuple[int, ...], device: torch.device) -> "Exposures":
        """Gains of 1 for all photos."""
        zeros = torch.zeros(len(views), 3, device=device)
        return cls({"log_gains": zeros, "visits": torch.zeros(len(views))}, views)

    def tensors(self) -> dict[str, Tensor]:
        """All state by name, for a checkpoint."""
        return {"log_gains": self.log_gains, "visits": self.visits}

    def applied(self, image: Tensor, view: int) -> Tensor:
        """A rendering [H, W, 3] in the photo's exposure; as it is where the photo has none."""
        row = self._row.get(view)
        return image if row is None else image * self.log_gains[row].exp()

    def solve(self, image: Tensor, target: Tensor, view: int, mask: Tensor | None = None) -> None:
        """Move a photo's gains towards those that make the render as bright as the photo.

        The ratio of sums, not least squares: it is unaffected by blur and noise of a render.

        Args:
            image: The render without a gain, [H, W, 3].
            target: The photo, [H, W, 3] in [0, 1].
            view: Index in the scene.
            mask: Share of each pixel that counts, [H, W]; None: all.
        """
        image = image.detach()
        counted = (target < SATURATED).all(dim=2).to(image)
        weights = (counted if mask is None else counted * mask)[:, :, None]
        sums = (target * weights).sum(dim=(0, 1)), (image * weights).sum(dim=(0, 1))
        self.move(view, sums, target.shape[0] * target.shape[1])

    def gains(self, view: int) -> tuple[float, float, float]:
        """A photo's gains; ones where it has none."""
        row = self._row.get(view)
        if row is None:
            return 1.0, 1.0, 1.0
        red, green, blue = self.log_gains[row].exp().tolist()
        return red, green, blue

    def move(self, view: int, sums: tuple[Tensor, Tensor], pixels: int) -> None:
        """See `solve`.

        Args:
            view: Index in the scene.
            sums: Of the photo and of the render without a gain, over what counts, [3] each.
            pixels: Of the photo.
        """
        row = self._row.get(view)
        if row is None:
            return
        prior = PRIOR * pixels * 0.5
        found = ((sums[0] + prior) / (sums[1] + prior)).clamp(1 / LIMIT, LIMIT).log()
        self.visits[row] += 1
        self.log_gains[row].lerp_(found, max(MEMORY, 1 / float(self.visits[row])))
        self.log_gains -= self.log_gains.mean(dim=0)


def unsaturated(image: Tensor, target: Tensor) -> Tensor:
    """A rendering with the photo's values where that is white and the rendering brighter.

    A saturated value says that the scene was at least as bright, and no more.

    Args:
        image: In the photo's exposure, [H, W, 3].
        target: The photo, [H, W, 3] in [0, 1].
    """
    return torch.where((target >= SATURATED) & (image > target), target, image)
