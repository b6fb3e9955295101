"""Level sizes to order: nested masks that fit a number of bytes per level (ours).

Slots are ranked by their removal effect (`training/levels/selection.py`); each level, coarsest
first, takes as many of the best as its bytes allow. Bytes are those of the packed file: the size
model is
handed in, because training knows no file format.
"""

from collections.abc import Callable, Sequence
from typing import Protocol

import torch
from torch import Tensor

from gsynopsis.model.anchors import AnchorModel
from gsynopsis.model.build import model_to_levels
from gsynopsis.records import LevelSet, Sensitivity

CLOSE = 0.004
"""A level within this share below its budget is close enough; the promise is 2 %."""
AHEAD = 1.1
"""Levels train with anchors for this many times their bytes; the weakest slots go afterwards."""
PROBES = 12
"""Packings per level at most."""


class SizeModel(Protocol):
    """Interface of the file format to training: sizes and rounding."""

    def sizes(self, levels: LevelSet) -> Sequence[int]:
        """Bytes of the file up to the end of each level."""
        ...

    def rounded(self, levels: LevelSet, sensitivity: Sensitivity, loss: float) -> LevelSet:
        """These levels with values that a file holds exactly; images lose about `loss` dB."""
        ...

    def trained(self, levels: LevelSet) -> list[list[int]]:
        """Bytes of each level in float32: rows as in the paper, the same deflated, a raw file."""
        ...


def fit_masks(
    model: AnchorModel, scores: Sequence[Tensor], budgets: Sequence[int], packer: SizeModel
) -> list[Tensor]:
    """Masks of all levels, nested, each of the largest size within its budget.

    Args:
        model: Its parts are the levels, coarsest first; masks are neither read nor changed.
        scores: Of every slot at each level, [N, K]; larger is taken first, 0 and below never.
        budgets: Bytes of the file up to the end of each level, ascending.
        packer: Gives the bytes of a level.

    Returns:
        Per level a bool mask [N, K]. A level whose budget is below what its networks and grids
        take keeps one slot; one whose budget is beyond all it could hold keeps everything.
    """
    masks: list[Tensor] = []
    for number, budget in enumerate(budgets):
        below = masks[-1] if masks else torch.zeros_like(scores[number], dtype=torch.bool)
        ranked = scores[number].masked_fill(below, 0).reshape(-1)
        order = torch.sort(ranked, descending=True, stable=True).indices
        order = order[: int((ranked > 0).sum())]
        least = 0 if number else 1

        def size_of(count: int, below: Tensor = below, order: Tensor = order) -> int:
            return _size(model, [*masks, _with_slots(below, order[:count])], packer)

        count = _largest(size_of, (least, len(order)), budget)
        masks.append(_with_slots(below, order[:count]))
    return masks


def _with_slots(below: Tensor, slots: Tensor) -> Tensor:
    mask = below.clone().reshape(-1)
    mask[slots] = True
    return mask.reshape(below.shape)


def _largest(size_of: Callable[[int], int], span: tuple[int, int], budget: int) -> int:
    """The largest count in a span whose size is within the budget, or nearly; the least if none.

    Sizes grow almost linearly with the count, so the next guess lies on the line between the
    nearest known sizes on either side.
    """
    low, high = span
    low_size, high_size = size_of(low), size_of(high)
    if high_size <= budget:
        return high
    for _ in range(PROBES):
        if high - low <= 1 or budget * (1 - CLOSE) <= low_size <= budget:
            break
        share = (budget * (1 - CLOSE / 2) - low_size) / max(1, high_size - low_size)
        guess = low + round(share * (high - low))
        guess = min(max(guess, low + 1), high - 1)
        size = size_of(guess)
        if size <= budget:
            low, low_size = guess, size
        else:
            high, high_size = guess, size
    return low


def _size(model: AnchorModel, masks: Sequence[Tensor], packer: SizeModel) -> int:
    """Bytes to the end of the last of these levels; the model is as before afterwards.

    Finer levels are there with the same slots, because the file's tables count them.
    """
    parts = [model.part(k) for k in range(len(model.parts))]
    before = [part.mask for part in parts]
    try:
        for number, part in enumerate(parts):
            part.mask = masks[min(number, len(masks) - 1)]
        return int(packer.sizes(model_to_levels(model, {}))[len(masks) - 1])
    finally:
        for part, mask in zip(parts, before, strict=True):
            part.mask = mask
