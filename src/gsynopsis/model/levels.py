"""Masks and parts of levels: the rules that make a level contain the coarser ones."""

from collections.abc import Sequence

import torch
from torch import Tensor

from gsynopsis.model.anchors import AnchorModel, LevelPart
from gsynopsis.model.heads import without_columns

HALVINGS = 50
"""Of the span in which the price of a slot is looked for."""


def rank_masks(scores: Sequence[Tensor], fractions: Sequence[float], slots: int) -> list[Tensor]:
    """Nested masks of whole anchors: a level has those of coarser ones and the best of the rest.

    Args:
        scores: Per level [N], larger comes first; of equal ones the lower row.
        fractions: Of all anchors that each level has, ascending, each in (0, 1].
        slots: K.

    Returns:
        Per level a bool mask [N, K]; each level with a positive fraction keeps an anchor.
    """
    rows, masks = torch.zeros_like(scores[0], dtype=torch.bool), list[Tensor]()
    for score, fraction in zip(scores, fractions, strict=True):
        count = min(len(score), max(1, round(fraction * len(score))))
        ranked = score.masked_fill(rows, torch.inf)
        rows = rows.clone()
        rows[torch.sort(ranked, descending=True, stable=True).indices[:count]] = True
        masks.append(rows[:, None].expand(-1, slots).clone())
    return masks


def without_faint(effects: Tensor, share: float, cost: float) -> Tensor:
    """The slots that are worth their room in a file, when a share of all effect may be lost (ours).

    Effects about add up, so the fewest bytes for what is lost have one price: a slot stays if its
    effect is above the price, and an anchor if what its slots have above it pays for the anchor.

    Args:
        effects: [N, K] ≥ 0, what the pictures would lose without each slot.
        share: Of their sum that all together may lose, in [0, 1); 0 keeps everything, also what
            has no effect.
        cost: Of an anchor, in slots, ≥ 0.

    Returns:
        A bool mask [N, K]; all stays where nothing has an effect.
    """
    effects = effects.double()
    total = float(effects.sum())
    if not share or not 0 < total < torch.inf:
        return torch.ones_like(effects, dtype=torch.bool)

    def worth(price: float) -> Tensor:
        above = (effects - price).clamp(min=0)
        return (above > 0) & (above.sum(dim=1, keepdim=True) > price * cost)

    low, high = 0.0, float(effects.sum(dim=1).max())
    for _ in range(HALVINGS):
        price = (low + high) / 2
        lost = total - float((effects * worth(price)).sum())
        low, high = (price, high) if lost <= share * total else (low, price)
    return worth(low)


def nested_masks(masks: Sequence[Tensor]) -> list[Tensor]:
    """The smallest masks that contain the given ones and are nested, coarsest first."""
    nested, below = [], torch.zeros_like(masks[0])
    for mask in masks:
        below = below | mask
        nested.append(below)
    return nested


def child_part(model: AnchorModel, parent: LevelPart, mask: Tensor, grids: int) -> LevelPart:
    """A coarser level's start: the parent's weights without the columns of dropped grids.

    Deleting a column is the same as feeding it zeros (methods.md §1.5).
    """
    width = model.layout.features
    networks = without_columns(dict(parent.networks.items()), grids * width, parent.grids * width)
    part = LevelPart(mask, grids, parent.codebook.detach().clone(), networks)
    part.log_gain.data.copy_(parent.log_gain.data)
    return part


def unite_networks(model: AnchorModel) -> None:
    """Give all levels the matrices of the finest, the same parameters; biases stay (ours)."""
    for number in range(len(model.parts) - 1):
        for name, weight in model.part(-1).networks.items():
            if weight.ndim == 2:
                model.part(number).networks[name] = weight


def spread_scores(lattice: Tensor, scores: Tensor, share: float) -> Tensor:
    """Scores divided by each anchor's place within its cell, so that no region goes empty (ours).

    A plain ranking keeps the dense, near part of a scene and leaves far walls without anchors. The
    best anchor of a cell keeps its score, the second has half of it, the third a third.

    Args:
        lattice: int64 [N, 3].
        scores: [N], positive.
        share: Cells grow until there are at most this many per anchor, in (0, 1].
    """
    size, cell = 1, torch.arange(len(lattice), device=lattice.device)
    while size < 1 << 20:
        size += max(1, size // 8)
        coarse = torch.div(lattice, size, rounding_mode="floor")
        cells, cell = torch.unique(coarse, dim=0, return_inverse=True)
        if len(cells) <= share * len(lattice):
            break
    by_score = torch.sort(scores, descending=True, stable=True).indices
    order = by_score[torch.sort(cell[by_score], stable=True).indices]
    place = torch.arange(len(order), device=order.device)
    first = torch.ones_like(place, dtype=torch.bool)
    first[1:] = cell[order][1:] != cell[order][:-1]
    start = torch.where(first, place, 0).cummax(0).values
    within = torch.empty_like(place)
    within[order] = place - start
    return scores / (1 + within)
