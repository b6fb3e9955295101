"""Which anchors and slots each level has, by what the pictures would lose without them (ours).

A picture is linear in the opacity of each Gaussian, so what leaving one out would change is known
from one backward pass (`render.base.removal_effects`). Blend weight, the usual score, counts what a
Gaussian covers, even where what lies behind it looks the same.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from gsynopsis.model.anchors import AnchorModel, LevelPart
from gsynopsis.model.levels import nested_masks, rank_masks, spread_scores, without_faint
from gsynopsis.render.base import Gaussians, blend_weights, removal_effects
from gsynopsis.scene.camera import Camera
from gsynopsis.train.budget import AHEAD, anchor_scores, fit_masks
from gsynopsis.train.trainer import Trainer


def rank_levels(trainer: Trainer) -> None:
    """Choose the anchors of every level by their effect, and switch faint slots off.

    The coarser the levels that have an anchor, the less of it goes, and of the coarsest nothing:
    few anchors have to show all there.
    """
    model, settings = model_of(trainer), trainer.config.levels
    effects, cost = slot_effects(trainer, -1), anchor_cost(model)
    last = len(settings.keep)
    shares = [settings.prune_share * (level / last) ** 2 for level in range(last)]
    shown_at = [without_faint(effects, s, cost) for s in (*shares, settings.prune_share)]
    shown = shown_at[-1]
    fractions = [float(shown.any(dim=1).double().mean())]
    for keep in settings.keep:
        fractions.insert(0, fractions[0] * keep)
    scores = [(effects * shown).sum(dim=1)] * len(fractions)
    scores[0] = spread_scores(model.lattice, scores[0], COVERAGE)
    masks = rank_masks(scores, fractions, model.slots)
    if settings.level_mib and trainer.packer is not None:
        ranks = [anchor_scores(effects * shown, score) for score in scores]
        sizes = [round(AHEAD * size) for size in settings.level_bytes]
        fitted = fit_masks(model, ranks, sizes, trainer.packer)
        coarser = [mask.any(dim=1, keepdim=True).expand_as(mask) for mask in fitted[:-1]]
        masks = [*coarser, masks[-1]]
    live = model.part(-1).mask
    kept = torch.zeros_like(live)
    for mask, stays in zip(masks, shown_at, strict=True):
        kept = kept | mask & live & stays
    for part, mask in zip(parts_of(model), masks, strict=True):
        part.mask = mask & kept


def anchor_cost(model: AnchorModel) -> float:
    """What a file holds of an anchor itself, in slots: values to the three of an offset."""
    return (model.log_scales.shape[1] + model.residual.shape[1]) / 3


def slot_effects(trainer: Trainer, level: int) -> Tensor:
    """What leaving out each slot of a level would change, summed over the training views, [N, K].

    Squared differences of colours, ≥ 0; 0 for what no view shows.
    """

    def of_view(gaussians: Gaussians, camera: Camera, view: int) -> Tensor:
        chance = torch.Generator().manual_seed(view)
        return removal_effects(trainer.renderer, gaussians, camera, trainer.background, chance)

    return _sum_of_slots(trainer, level, of_view)


def slot_contributions(trainer: Trainer, level: int) -> Tensor:
    """Blend weight of every slot of a level summed over the training views, [N, K] pixels."""

    def of_view(gaussians: Gaussians, camera: Camera, view: int) -> Tensor:
        return blend_weights(trainer.renderer, gaussians, camera)

    return _sum_of_slots(trainer, level, of_view)


def drop_dead_slots(trainer: Trainer) -> None:
    """Masks without slots that no training view shows; lossless on the training views (§1.10)."""
    model = model_of(trainer)
    seen = [slot_contributions(trainer, k) > 0 for k in range(len(model.parts))]
    live = [m & model.part(k).mask for k, m in enumerate(seen)]
    for part, mask in zip(parts_of(model), nested_masks(live), strict=True):
        part.mask = mask


def _sum_of_slots(
    trainer: Trainer, level: int, of_view: Callable[[Gaussians, Camera, int], Tensor]
) -> Tensor:
    """A number of each Gaussian of a level by view, summed over the training views, [N, K]."""
    model = model_of(trainer)
    size = len(model) * model.slots

    def in_slots(view: int) -> Tensor:
        camera = trainer.scene.camera(view, trainer.config.scale)
        with torch.no_grad():
            decoded = model.decode_part(model.part(level), camera)
        found = of_view(decoded.gaussians, camera, view)
        return found.new_zeros(size).index_add_(0, decoded.slots, found)

    return trainer.sum_over("weighing slots", trainer.scene.train, size, in_slots).view(
        -1, model.slots
    )


def model_of(trainer: Trainer) -> AnchorModel:
    """What a trainer trains, once a phase has begun."""
    assert trainer.model is not None
    return trainer.model


def parts_of(model: AnchorModel) -> list[LevelPart]:
    """What each level has of its own, coarsest first."""
    return [model.part(k) for k in range(len(model.parts))]
