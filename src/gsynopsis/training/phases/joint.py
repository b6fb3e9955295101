"""All levels at once: nested anchors by their removal effect, a few levels each step (ours).

The paper freezes what levels share before any coarse level is trained. Here offsets, scales,
grids, codebook choice and the per-level heads learn together, each step on a few levels, and
are frozen afterwards; levels stay nested by construction (methods.md §2.1).
"""

import math
from collections.abc import Iterable, Sequence

from gsynopsis.config import Joint
from gsynopsis.model.build import freeze_codes, model_from_levels, model_to_levels
from gsynopsis.model.levels import coarser_part
from gsynopsis.records import LevelSet
from gsynopsis.training.levels.selection import (
    anchor_cost,
    largest_multipliers,
    prune_unseen_slots,
    rank_levels,
    slot_effects,
    slot_scores,
)
from gsynopsis.training.levels.sensitivity import sensitivity_of
from gsynopsis.training.levels.size_budget import SizeModel, fit_masks
from gsynopsis.training.optim.adam import Optimizer
from gsynopsis.training.optim.param_groups import (
    level_parameters,
    rates_of,
    row_parameters,
    shared_parameters,
)
from gsynopsis.training.state import TrainState, bring_home, set_model
from gsynopsis.training.step import (
    next_views,
    non_finite,
    optimizer_step,
    reduced_factor,
    synced_views,
)
from gsynopsis.training.view_step import train_view

PRUNE_AT = (0.1, 0.2, 0.3, 0.4, 0.5)
"""Fractions of the joint steps after which slots are pruned and levels ranked again.

The remaining slots have the remaining steps to recover (ours; fewer, larger cuts are worse).
"""


class JointPhase:
    """Splits the model into levels and trains them together to the end of the schedule."""

    name = "joint"
    averages = True

    def __init__(self, levels: Joint, before: int) -> None:
        """Begin the schedule after `before` steps, those of the full training."""
        self.levels, self.steps, self.before = levels, levels.steps, before
        moments = PRUNE_AT if levels.prune_share else ()
        self.cuts = {round(moment * self.steps) for moment in moments} - {0}

    def begin(self, state: TrainState) -> None:
        """Give every level its own heads, and its anchors by their removal effect.

        A block has those heads already: they are the whole's.
        """
        model = state.model
        # Tied matrices have a column for each grid value, so all levels must read the same grids.
        drop = 0 if self.levels.tied else state.context.config.model.grid_drop
        while len(model.parts) < self.levels.count:
            parent = model.part(0)
            grids = max(0, parent.grids - drop)
            # Level 0 is the coarsest: each new part goes in front of the one it is made from.
            model.parts.insert(0, coarser_part(model, parent, parent.mask.clone(), grids))
        set_model(state, model)
        rank_levels(state, self.levels, self._cuts_after(0))

    def make_optimizer(self, state: TrainState) -> Optimizer:
        """Shared tensors once, and each level's own; of a block its anchors alone."""
        model, context = state.model, state.context
        if context.region is None:
            parameters = shared_parameters(model) | level_parameters(model)
        else:
            parameters = row_parameters(model)
        free = context.config.model.feature == "free"
        return Optimizer(parameters, rates_of(parameters, context.rates, model.frame.extent, free))

    def step(self, state: TrainState) -> None:
        """A batch of views at a few levels drawn at random, their gradients added."""
        # Several small cuts: after each, the remaining slots have steps to recover.
        if state.progress.step in self.cuts:
            bring_home(state)
            rank_levels(state, self.levels, self._cuts_after(state.progress.step))
        number, levels = state.progress.step + 1, self._drawn(state)
        # One schedule over both phases: rates go on from the end of the full training.
        progress = (self.before + number) / (self.before + self.steps)
        state.factor = reduced_factor(state, progress)
        for view in synced_views(state, next_views(state)):
            self.train_levels(state, levels, view)
        state.optimizer.set_progress(progress)
        optimizer_step(state)

    def train_levels(self, state: TrainState, levels: Iterable[int], view: int) -> None:
        """Forward and backward of one view at several levels; their weighted gradients add up.

        Raises:
            DivergedError: see `train_view`.
        """
        # One level after the other: gradients add up, and only one level's image is in memory.
        for level in levels:
            weight = self._weight(level, len(state.model.parts))
            train_view(state, state.model.part(level), view, state.factor, weight)

    def end(self, state: TrainState) -> None:
        """Freeze the codebook choice, switch off what no training view ever shows, round.

        Not in a block: other views may show it, and values are rounded when all blocks are one.
        """
        if state.context.region is not None:
            return
        packer, sizes = state.context.size_model, self.levels.level_bytes
        # Rounding and sizes below need the codes that the file stores, not their logits.
        freeze_codes(state.model)
        # With sizes to fit, dead slots go first anyway: their effect is 0.
        if packer is None or not sizes:
            prune_unseen_slots(state, self.levels.prune_share)
        if packer is not None:
            exact = round_values(state, packer, self.levels.coding_loss)
            if sizes:
                fit_budget(state, packer, sizes)
            # The report compares the file with the trained values, under the masks of the file.
            if exact is not None:
                state.progress.trained_bytes = packer.trained(with_masks_of(state, exact))

    def _cuts_after(self, step: int) -> int:
        """Rankings that are to come after a step's."""
        return sum(cut > step for cut in self.cuts)

    def _drawn(self, state: TrainState) -> list[int]:
        """Levels of a step: the finest, and others by chance."""
        count = len(state.model.parts)
        wanted = min(self.levels.levels_per_step, count) - 1
        others = math.floor(wanted)
        # Half a level more is one more in every second step; whole numbers draw no chance.
        if wanted > others:
            others += int(state.rng.random() < wanted - others)
        # The finest is in every step: it alone trains the values of all slots.
        return [*state.rng.choice(count - 1, size=others, replace=False).tolist(), count - 1]

    def _weight(self, level: int, count: int) -> float:
        """Factor on a level's loss; the finest has none."""
        weights = self.levels.loss_weights[: count - 1]
        return weights[level] if level < len(weights) else 1.0


def fit_budget(state: TrainState, packer: SizeModel, sizes: Sequence[int]) -> None:
    """Masks by the exact bytes that were ordered, coarsest first; dead slots go first.

    What is worth least for its bytes goes: a slot, or an anchor whose slots together do not pay.
    """
    parts, cost = state.model.level_parts(), anchor_cost(state.model)
    effects = [slot_effects(state, level) for level in range(len(parts))]
    worth = [largest_multipliers(effect, cost) for effect in effects]
    scores = slot_scores(worth, [part.mask for part in parts])
    masks = fit_masks(state.model, scores, sizes, packer)
    for part, mask in zip(parts, masks, strict=True):
        part.mask = mask


def with_masks_of(state: TrainState, levels: LevelSet) -> LevelSet:
    """Other values of the same anchors, with the masks that the model has now."""
    model = model_from_levels(levels)
    for part, now in zip(model.level_parts(), state.model.level_parts(), strict=True):
        part.mask = now.mask.cpu()
    return model_to_levels(model, {})


def round_values(state: TrainState, packer: SizeModel, loss: float) -> LevelSet | None:
    """Round all values to those of the file; rows are in the file's order afterwards.

    Values that are not finite stay: saving the model reports them.

    Args:
        state: Its model is replaced.
        packer: Rounds.
        loss: Distortion that this may add to the finest level, dB; 0 leaves all values.

    Returns:
        The values before, in the new order of the rows; None if nothing was rounded.
    """
    if not loss or non_finite(state):
        return None
    levels = model_to_levels(state.model, {})
    rounded = packer.rounded(levels, sensitivity_of(state, levels), loss)
    set_model(state, model_from_levels(rounded))
    return levels
