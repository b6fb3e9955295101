"""Masks and parts of levels: the rules that make a level contain the coarser ones."""

from collections.abc import Sequence

import torch
from torch import Tensor

from gsynopsis.model.anchors import AnchorModel, LevelPart
from gsynopsis.model.heads import without_columns


def rank_masks(scores: Tensor, fractions: Sequence[float], slots: int) -> list[Tensor]:
    """Nested masks of whole anchors: level k keeps the best `fractions[k]` by score.

    Args:
        scores: [N], larger is kept longer; ties keep the lower row.
        fractions: Ascending, each in (0, 1].
        slots: K.

    Returns:
        Per level a bool mask [N, K]; each level with a positive fraction keeps an anchor.
    """
    order = torch.sort(scores, descending=True, stable=True).indices
    masks = []
    for fraction in fractions:
        count = min(len(scores), max(1, round(fraction * len(scores))))
        rows = torch.zeros(len(scores), dtype=torch.bool, device=scores.device)
        rows[order[:count]] = True
        masks.append(rows[:, None].expand(-1, slots).clone())
    return masks


def without_faint(weights: Tensor, share: float) -> Tensor:
    """All slots but the faintest, which together carry at most a share of the weight (ours).

    Trained further, a model hardly misses them, while each costs the file three offsets.

    Args:
        weights: [N, K] ≥ 0, the blend weight of each slot over all training views.
        share: Of their sum, in [0, 1); 0 keeps everything, also what shows nothing.

    Returns:
        A bool mask [N, K]; the strongest slot is always kept, equal ones stay or go together.
    """
    ordered = torch.sort(weights.double().reshape(-1)).values
    carried = ordered.cumsum(0) / ordered.sum()
    faint = int((carried <= share).sum()) if share else 0
    return weights >= ordered[faint] if faint else torch.ones_like(weights, dtype=torch.bool)


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
