"""All levels at once: nested anchors by blend weight, a random level each step (ours).

The paper freezes what levels share before any coarse level is trained. Here offsets, scales,
grids, codebook choice and the per-level heads learn together, each step on one level, and are
frozen afterwards; levels stay nested by construction (methods.md A22, prototype's figures).
"""

import torch
from torch import Tensor

from gsynopsis.model.anchors import AnchorModel, LevelPart
from gsynopsis.model.build import freeze_codes, model_from_levels, model_to_levels
from gsynopsis.model.levels import (
    child_part,
    nested_masks,
    rank_masks,
    spread_scores,
    without_faint,
)
from gsynopsis.render.base import blend_weights
from gsynopsis.train.budget import AHEAD, Packer, anchor_scores, fit_masks, slot_scores
from gsynopsis.train.optimiser import Optimiser
from gsynopsis.train.sensitivity import sensitivity_of
from gsynopsis.train.trainer import Trainer, level_parameters, rates_of, shared_parameters

CUTS = (0.2, 0.4)
"""Fractions of the joint steps after which slots that have become faint go and levels are ranked
anew: what is left has the rest of the steps to fill in (ours; once at the split is worse)."""


class JointPhase:
    """Splits the model into levels and trains them together to the end of the schedule."""

    name = "joint"
    settles = True

    def __init__(self, steps: int, before: int) -> None:
        """`before` is how many steps of the schedule the full training has used."""
        self.steps, self.before = steps, before
        self.cuts = {round(moment * steps) for moment in CUTS} - {0}

    def begin(self, trainer: Trainer) -> None:
        """Give every level its own heads, and its anchors by what they contribute."""
        model, settings = _model(trainer), trainer.config.levels
        for _ in settings.keep:
            parent = model.part(0)
            grids = max(0, parent.grids - settings.grid_drop)
            model.parts.insert(0, child_part(model, parent, parent.mask.clone(), grids))
        rank_levels(trainer)

    def make_optimiser(self, trainer: Trainer) -> Optimiser:
        """Shared tensors once, and each level's own."""
        model = _model(trainer)
        parameters = shared_parameters(model)
        parameters |= level_parameters(model, trainer.config.levels.gain)
        free = trainer.config.model.feature == "free"
        rates = rates_of(parameters, trainer.config.train.rates, model.frame.extent, free)
        return Optimiser(parameters, rates)

    def step(self, trainer: Trainer) -> None:
        """A batch of views at a few levels drawn at random, their gradients added."""
        assert trainer.optimiser is not None
        model, settings = _model(trainer), trainer.config.levels
        if settings.faint_share and trainer.cursor.step in self.cuts:
            rank_levels(trainer)
        number, count = trainer.cursor.step + 1, len(model.parts)
        together = min(settings.together, count)
        chances = settings.probabilities or None
        drawn = trainer.rng.choice(count, size=together, replace=False, p=chances)
        for view in trainer.batch(trainer.next_views()):
            trainer.learn_levels(drawn, view)
        if number > self.steps * (1 - settings.adapt):
            for parameter in shared_parameters(model).values():
                parameter.grad = None
        progress = (self.before + number) / (self.before + self.steps)
        trainer.optimiser.set_progress(progress, settings.joint_rates)
        trainer.optimiser.step()

    def end(self, trainer: Trainer) -> None:
        """Freeze the codebook choice, switch off what no training view ever shows, round."""
        packer, ordered = trainer.packer, trainer.config.levels.level_mib
        freeze_codes(_model(trainer))
        if packer is None or not ordered:
            drop_dead_slots(trainer)
        if packer is not None:
            round_values(trainer, packer)
            if ordered:
                fit_budget(trainer, packer)


def rank_levels(trainer: Trainer) -> None:
    """Choose the anchors of every level by their blend weight, and switch faint slots off.

    The coarser the levels that have an anchor, the less of it goes, and of the coarsest nothing:
    few anchors have to show all there.
    """
    model, settings = _model(trainer), trainer.config.levels
    contributions = slot_contributions(trainer, -1)
    last = len(settings.keep)
    parts = [(level / last) ** 2 for level in range(last)]
    shown_at = [without_faint(contributions, settings.faint_share * p) for p in (*parts, 1.0)]
    shown = shown_at[-1]
    scores = (contributions * shown).sum(dim=1)
    if settings.spread:
        scores = spread_scores(model.lattice, scores, settings.spread)
    fractions = [float(shown.any(dim=1).double().mean())]
    for keep in settings.keep:
        fractions.insert(0, fractions[0] * keep)
    masks = rank_masks(scores, fractions, model.slots)
    if settings.level_mib and trainer.packer is not None:
        ranks = [anchor_scores(contributions * shown, scores)] * len(model.parts)
        sizes = [round(AHEAD * size) for size in settings.level_bytes]
        fitted = fit_masks(model, ranks, sizes, trainer.packer)
        coarser = [mask.any(dim=1, keepdim=True).expand_as(mask) for mask in fitted[:-1]]
        masks = [*coarser, masks[-1]]
    live = model.part(-1).mask
    kept = torch.zeros_like(live)
    for mask, stays in zip(masks, shown_at, strict=True):
        kept = kept | mask & live & stays
    for part, mask in zip(_parts(model), masks, strict=True):
        part.mask = mask & kept


def fit_budget(trainer: Trainer, packer: Packer) -> None:
    """Masks by the exact bytes that were ordered; slots that show nothing go first."""
    model, settings = _model(trainer), trainer.config.levels
    contributions = [slot_contributions(trainer, k) for k in range(len(model.parts))]
    scores = slot_scores(contributions, [part.mask for part in _parts(model)])
    masks = fit_masks(model, scores, settings.level_bytes, packer)
    for part, mask in zip(_parts(model), masks, strict=True):
        part.mask = mask


def round_values(trainer: Trainer, packer: Packer) -> None:
    """Give all values what the file will hold of them; rows are in the file's order afterwards.

    Values that are not finite stay: whoever saves them says so.
    """
    loss = trainer.config.levels.coding_loss
    if not loss or trainer.non_finite():
        return
    levels = model_to_levels(_model(trainer), {})
    found = packer.rounded(levels, sensitivity_of(trainer, levels), loss)
    trainer.model = model_from_levels(found).to(trainer.renderer.device)


def slot_contributions(trainer: Trainer, level: int) -> Tensor:
    """Blend weight of every slot of a level summed over the training views, [N, K] pixels."""
    model = _model(trainer)
    size = len(model) * model.slots

    def of_view(view: int) -> Tensor:
        camera = trainer.scene.camera(view, trainer.config.scale)
        with torch.no_grad():
            decoded = model.decode_part(model.part(level), camera)
        weights = blend_weights(trainer.renderer, decoded.gaussians, camera)
        return weights.new_zeros(size).index_add_(0, decoded.slots, weights)

    return trainer.sum_over(trainer.scene.train, size, of_view).view(-1, model.slots)


def drop_dead_slots(trainer: Trainer) -> None:
    """Masks without slots that no training view shows; lossless on the training views (§1.10)."""
    model = _model(trainer)
    seen = [slot_contributions(trainer, k) > 0 for k in range(len(model.parts))]
    live = [m & model.part(k).mask for k, m in enumerate(seen)]
    for part, mask in zip(_parts(model), nested_masks(live), strict=True):
        part.mask = mask


def _model(trainer: Trainer) -> AnchorModel:
    assert trainer.model is not None
    return trainer.model


def _parts(model: AnchorModel) -> list[LevelPart]:
    return [model.part(k) for k in range(len(model.parts))]
