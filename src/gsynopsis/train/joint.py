"""All levels at once: nested anchors by their effect, a few levels each step (ours).

The paper freezes what levels share before any coarse level is trained. Here offsets, scales,
grids, codebook choice and the per-level heads learn together, each step on a few levels, and
are frozen afterwards; levels stay nested by construction (methods.md §2.1).
"""

from gsynopsis.model.build import freeze_codes, model_from_levels, model_to_levels
from gsynopsis.model.levels import child_part
from gsynopsis.train.budget import Packer, fit_masks, slot_scores
from gsynopsis.train.optimiser import Optimiser
from gsynopsis.train.ranking import (
    drop_dead_slots,
    model_of,
    parts_of,
    rank_levels,
    slot_effects,
)
from gsynopsis.train.sensitivity import sensitivity_of
from gsynopsis.train.trainer import Trainer, level_parameters, rates_of, shared_parameters

CUTS = (0.1, 0.2, 0.3, 0.4, 0.5)
"""Fractions of the joint steps after which slots that have become faint go and levels are ranked
anew: what is left has the rest of the steps to fill in (ours; fewer, larger cuts are worse)."""


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
        model, settings = model_of(trainer), trainer.config.levels
        for _ in settings.keep:
            parent = model.part(0)
            grids = max(0, parent.grids - 0 if settings.tied else trainer.config.model.grid_drop)
            model.parts.insert(0, child_part(model, parent, parent.mask.clone(), grids))
        trainer.adopt(model)
        rank_levels(trainer)

    def make_optimiser(self, trainer: Trainer) -> Optimiser:
        """Shared tensors once, and each level's own."""
        model = model_of(trainer)
        parameters = shared_parameters(model)
        parameters |= level_parameters(model, trainer.config.levels.learns_scale)
        free = trainer.config.model.feature == "free"
        rates = rates_of(parameters, trainer.rates, model.frame.extent, free)
        return Optimiser(parameters, rates)

    def step(self, trainer: Trainer) -> None:
        """A batch of views at a few levels drawn at random, their gradients added."""
        assert trainer.optimiser is not None
        model, settings = model_of(trainer), trainer.config.levels
        if settings.prune_share and trainer.cursor.step in self.cuts:
            rank_levels(trainer)
        number, count = trainer.cursor.step + 1, len(model.parts)
        together = min(settings.levels_per_step, count)
        if settings.always_finest:
            others = trainer.rng.choice(count - 1, size=together - 1, replace=False)
            drawn = [*others.tolist(), count - 1]
        else:
            drawn = trainer.rng.choice(count, size=together, replace=False).tolist()
        for view in trainer.batch(trainer.next_views()):
            trainer.learn_levels(drawn, view)
        progress = (self.before + number) / (self.before + self.steps)
        trainer.optimiser.set_progress(progress)
        trainer.optimiser.step()

    def end(self, trainer: Trainer) -> None:
        """Freeze the codebook choice, switch off what no training view ever shows, round."""
        packer, ordered = trainer.packer, trainer.config.levels.level_mib
        freeze_codes(model_of(trainer))
        if packer is None or not ordered:
            drop_dead_slots(trainer)
        if packer is not None:
            round_values(trainer, packer)
            if ordered:
                fit_budget(trainer, packer)


def fit_budget(trainer: Trainer, packer: Packer) -> None:
    """Masks by the exact bytes that were ordered; slots that show nothing go first."""
    model, settings = model_of(trainer), trainer.config.levels
    effects = [slot_effects(trainer, k) for k in range(len(model.parts))]
    scores = slot_scores(effects, [part.mask for part in parts_of(model)])
    masks = fit_masks(model, scores, settings.level_bytes, packer)
    for part, mask in zip(parts_of(model), masks, strict=True):
        part.mask = mask


def round_values(trainer: Trainer, packer: Packer) -> None:
    """Give all values what the file will hold of them; rows are in the file's order afterwards.

    Values that are not finite stay: whoever saves them says so.
    """
    loss = trainer.config.levels.coding_loss
    if not loss or trainer.non_finite():
        return
    levels = model_to_levels(model_of(trainer), {})
    found = packer.rounded(levels, sensitivity_of(trainer, levels), loss)
    trainer.adopt(model_from_levels(found))
