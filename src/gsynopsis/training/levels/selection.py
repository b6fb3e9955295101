"""Anchors and slots of each level, chosen by their removal effect (ours).

The removal effect of a Gaussian is the squared change of the training images without it. An image
is linear in the opacity of each Gaussian, so one pass over it gives the effects of all
(`render.measures.removal_effects`). Blend weight, the usual score, counts the pixels that a
Gaussian covers, even if the surface behind it looks the same.

First pure functions of tensors, then those that go over the training views.
"""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from gsynopsis.config import Joint
from gsynopsis.model.anchors import AnchorModel
from gsynopsis.model.build import model_to_levels
from gsynopsis.model.lattice import KEY_LIMIT, lattice_keys
from gsynopsis.render.base import Gaussians
from gsynopsis.render.measures import blend_weights, removal_effects
from gsynopsis.scene.camera import Camera, positions_of
from gsynopsis.training.distributed.view_sums import sum_over_views
from gsynopsis.training.growth import edit_rows
from gsynopsis.training.levels.size_budget import AHEAD, fit_masks
from gsynopsis.training.state import TrainState
from gsynopsis.training.step import trainable_anchors
from gsynopsis.training.view_step import background_of

COVERAGE = 0.125
"""Cells per anchor of the full model; the coarsest level keeps the best of each."""
MOST_OCTAVES = 16
"""Beyond as many doublings of the cameras' extent cells grow no more."""


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


def nested_masks(masks: Sequence[Tensor]) -> list[Tensor]:
    """The smallest masks that contain the given ones and are nested, coarsest first."""
    nested, below = [], torch.zeros_like(masks[0])
    for mask in masks:
        below = below | mask
        nested.append(below)
    return nested


def rate_distortion_masks(effects: Tensor, shares: Sequence[float], cost: float) -> list[Tensor]:
    """Rate–distortion pruning: the fewest bytes when a share of all removal effect may be lost.

    Effects about add up, so one Lagrange multiplier λ decides: a slot stays if its effect is above
    λ, and an anchor if the excess of its slots over λ is above λ times the anchor's own cost.

    Args:
        effects: Removal effect of each slot, [N, K] ≥ 0.
        shares: Of their sum that all pruned ones together may have, each in [0, 1); 0 keeps
            everything, also what has no effect.
        cost: Of an anchor, in slots, ≥ 0.

    Returns:
        For each share a bool mask [N, K]; all stays where nothing has an effect.
    """
    effects = effects.double()
    total = float(effects.sum())
    masks = [torch.ones_like(effects, dtype=torch.bool) for _ in shares]
    if not any(shares) or not 0 < total < torch.inf:
        return masks
    bounds = largest_multipliers(effects, cost)
    ascending, order = torch.sort(bounds[bounds > 0])
    lost = effects[bounds > 0][order].cumsum(0)
    for number, share in enumerate(shares):
        if share:
            pruned = int(torch.searchsorted(lost, share * total, right=True))
            masks[number] = bounds >= ascending[min(pruned, len(ascending) - 1)]
    return masks


def largest_multipliers(effects: Tensor, cost: float) -> Tensor:
    """Below which λ each slot stays, float64 [N, K]: its effect, or where its anchor does not pay.

    The excess of an anchor's slots over λ is largest for its m best ones, S_m − m λ, for some m. It
    is above λ·cost for a λ below S_m / (m + cost), so the anchor stays below the largest of those.
    """
    effects = effects.double()
    best = torch.sort(effects, dim=1, descending=True).values.cumsum(dim=1)
    room = torch.arange(1, effects.shape[1] + 1, device=effects.device) + cost
    return torch.minimum(effects, (best / room).amax(dim=1, keepdim=True))


def octaves_of(places: Tensor, middle: Tensor, extent: float) -> Tensor:
    """Doublings of the cameras' extent that each anchor lies beyond, int64 [N], ≥ 0.

    Args:
        places: Of anchors, [N, 3].
        middle: Mean place of the training cameras, [3].
        extent: Their reach, world units.
    """
    away = (places - middle).norm(dim=1) / extent
    return away.clamp(1, 2**MOST_OCTAVES).log2().floor().long()


def coverage_cell(lattice: Tensor, octaves: Tensor, share: float) -> int:
    """Side of the nearest cells, in voxels, with at most `share` cells per anchor, in (0, 1].

    Args:
        lattice: int64 [N, 3].
        octaves: Of each anchor, int64 [N], see `octaves_of`.
        share: Cells grow until there are no more.
    """
    size = 1
    while size < KEY_LIMIT:
        size += max(1, size // 8)
        if len(torch.unique(_cells(lattice, octaves, size))) <= share * len(lattice):
            break
    return size


def coverage_weighted_scores(lattice: Tensor, octaves: Tensor, scores: Tensor, size: int) -> Tensor:
    """Scores divided by the root of each anchor's place within its cell: no region goes empty.

    A plain ranking keeps the dense, near part of a scene and leaves far walls without anchors, one
    by the place itself leaves the near part without. The best anchor of a cell keeps its score, the
    fourth has half of it, the ninth a third.

    Args:
        lattice: int64 [N, 3].
        octaves: Of each anchor, int64 [N], see `octaves_of`.
        scores: [N], positive.
        size: Of the nearest cells, see `coverage_cell`.
    """
    cell = _cells(lattice, octaves, size)
    by_score = torch.sort(scores, descending=True, stable=True).indices
    order = by_score[torch.sort(cell[by_score], stable=True).indices]
    place = torch.arange(len(order), device=order.device)
    first = torch.ones_like(place, dtype=torch.bool)
    first[1:] = cell[order][1:] != cell[order][:-1]
    start = torch.where(first, place, 0).cummax(0).values
    within = torch.empty_like(place)
    within[order] = place - start
    return scores / (1 + within).sqrt()


def _cells(lattice: Tensor, octaves: Tensor, size: int) -> Tensor:
    """The cell of each anchor, int64 [N]: twice as wide with each octave.

    Cells of one width would let hills far away, of few pixels, count for as much as a house before
    the cameras.
    """
    side = (size << octaves)[:, None]
    return lattice_keys((lattice.div(side, rounding_mode="floor") * side).clamp(min=-KEY_LIMIT))


def slot_scores(effects: Sequence[Tensor], masks: Sequence[Tensor]) -> list[Tensor]:
    """For each level the score of all slots: its own by effect, then those of finer levels.

    Args:
        effects: Removal effect of each slot at each level, [N, K] ≥ 0; 0 for slots that are not in
            the level's mask.
        masks: Per level the mask it was trained with, [N, K].
    """
    finest = effects[-1]
    scores: list[Tensor] = []
    for own, mask in zip(effects, masks, strict=True):
        borrowed = finest / finest.max().clamp(min=1e-20)
        shown = own > 0
        scores.append(torch.where(mask & shown, own + 2 * borrowed.max(), borrowed * ~mask))
    return scores


def anchor_scores(effects: Tensor, scores: Tensor) -> Tensor:
    """Scores of slots by their whole anchor, [N, K]; 0 for slots without a removal effect.

    Args:
        effects: Removal effect of each slot, [N, K].
        scores: Of each anchor, [N].
    """
    return torch.where(effects > 0, scores[:, None], 0)


def anchor_cost(model: AnchorModel) -> float:
    """Rate of an anchor itself, in slots: its own values to the three of an offset."""
    return (model.log_scales.shape[1] + model.residual.shape[1]) / 3


def rank_levels(state: TrainState, levels: Joint, later: int = 0) -> None:
    """Choose the anchors of every level by their removal effect, and prune slots.

    The coarser the levels that have an anchor, the less of it is pruned, and of the coarsest
    nothing: few anchors have to show all there. Anchors that do not move keep their levels.

    Args:
        state: Its model's masks change, and anchors without slots leave it.
        levels: Settings.
        later: Rankings that are still to come, after which the finest level has its ordered size.
    """
    model, parts, moving = state.model, state.model.level_parts(), trainable_anchors(state)
    effects, cost = slot_effects(state, -1), anchor_cost(model)
    if moving is not None:
        effects = effects * moving[:, None]
    last = len(levels.keep)
    shares = [levels.prune_share * (level / last) ** 2 for level in range(last)]
    shown_at = rate_distortion_masks(effects, (*shares, levels.prune_share), cost)
    shown = shown_at[-1]
    fractions = [float(shown.any(dim=1).double().mean())]
    for keep in levels.keep:
        fractions.insert(0, fractions[0] * keep)
    scores = [(effects * shown).sum(dim=1)] * len(fractions)
    progress = state.progress
    # Found once: anchors that this ranking drops count at the next one too.
    scene = state.context.scene
    middle = torch.tensor(positions_of(scene.views[v].camera for v in scene.train).mean(axis=0))
    octaves = octaves_of(model.placed()[0], middle.to(effects), scene.extent)
    cell = progress.coverage_cell or coverage_cell(model.lattice, octaves, COVERAGE)
    scores[0] = coverage_weighted_scores(model.lattice, octaves, scores[0], cell)
    progress.coverage_cell = cell
    masks = rank_masks(scores, fractions, model.slots)
    packer = state.context.size_model
    if levels.level_mib and packer is not None:
        ranks = [anchor_scores(effects * shown, score) for score in scores]
        ranks[-1] = largest_multipliers(effects * shown, cost)
        sizes = [round(AHEAD * size) for size in levels.level_bytes]
        now = packer.sizes(model_to_levels(model, {}))[-1]
        sizes[-1] = max(sizes[-1], round(now * (sizes[-1] / now) ** (1 / (later + 1))))
        *fitted, finest = fit_masks(model, ranks, sizes, packer)
        coarser = [mask.any(dim=1, keepdim=True).expand_as(mask) for mask in fitted]
        masks = nested_masks([*coarser, finest])
    live = model.part(-1).mask
    kept = torch.zeros_like(live)
    for mask, stays in zip(masks, shown_at, strict=True):
        kept = kept | mask & live & stays
    for part, mask in zip(parts, masks, strict=True):
        ranked = mask & kept
        part.mask = ranked if moving is None else torch.where(moving[:, None], ranked, part.mask)
    if moving is None:
        drop_empty_anchors(state)


def drop_empty_anchors(state: TrainState) -> None:
    """Anchors that no level shows leave the model; what is left keeps its order and moments."""
    model = state.model
    keep = model.part(-1).mask.any(dim=1)
    if keep.all() or not keep.any():
        return
    edit_rows(model, state.optimizer if state.progress.begun else None, keep)


def slot_effects(state: TrainState, level: int) -> Tensor:
    """Removal effect of each slot of a level, summed over the training views, [N, K].

    Squared differences of colours, ≥ 0; 0 for a slot that no view shows.
    """

    def of_view(gaussians: Gaussians, camera: Camera, view: int) -> Tensor:
        chance = torch.Generator().manual_seed(view)
        behind = background_of(state, view)
        return removal_effects(state.context.renderer, gaussians, camera, behind, chance)

    return _sum_of_slots(state, level, of_view)


def slot_contributions(state: TrainState, level: int) -> Tensor:
    """Blend weight of every slot of a level summed over the training views, [N, K] pixels."""

    def of_view(gaussians: Gaussians, camera: Camera, view: int) -> Tensor:
        return blend_weights(state.context.renderer, gaussians, camera)

    return _sum_of_slots(state, level, of_view)


def prune_unseen_slots(state: TrainState, coarse_share: float = 0.0) -> None:
    """Masks without slots that no training view shows; lossless on the training views (§1.10).

    Args:
        state: Its model's masks change.
        coarse_share: Of all removal effect at a coarser level, what further slots of it may have
            together, in [0, 1): they come with the first level that needs them (§2.3).
    """
    parts, shown = state.model.level_parts(), list[Tensor]()
    for level in range(len(parts)):
        if coarse_share and level < len(parts) - 1:
            effects = slot_effects(state, level)
            shown += rate_distortion_masks(effects, (coarse_share,), 0)
        else:
            shown.append(slot_contributions(state, level) > 0)
    live = [mask & part.mask for mask, part in zip(shown, parts, strict=True)]
    for part, mask in zip(parts, nested_masks(live), strict=True):
        part.mask = mask


def _sum_of_slots(
    state: TrainState, level: int, of_view: Callable[[Gaussians, Camera, int], Tensor]
) -> Tensor:
    """A number of each Gaussian of a level by view, summed over the training views, [N, K]."""
    model, scene = state.model, state.context.scene
    size = len(model) * model.slots

    def add(view: int, total: Tensor) -> None:
        camera = scene.camera(view, state.context.config.scale)
        with torch.no_grad():
            decoded = model.decode_part(model.part(level), camera)
        total.index_add_(0, decoded.slots, of_view(decoded.gaussians, camera, view))

    return sum_over_views(state, "weighing slots", scene.train, size, add).view(-1, model.slots)
