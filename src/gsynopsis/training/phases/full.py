"""The full model: the finest level, with growing and pruning (methods.md §1.7–§1.10)."""

from dataclasses import replace

from gsynopsis.training.growth import (
    ADJUST_FROM,
    STATISTICS_FROM,
    GrowthStatistics,
    adjust,
    find_seeds,
    growth_limit,
    merged,
)
from gsynopsis.training.optim.adam import Optimizer
from gsynopsis.training.optim.param_groups import (
    part_parameters,
    rates_of,
    row_parameters,
    shared_parameters,
)
from gsynopsis.training.regularize.floaters import floaters
from gsynopsis.training.state import TrainState, bring_home
from gsynopsis.training.step import (
    next_views,
    optimizer_step,
    reduced_factor,
    sync_losses,
    synced_views,
    trainable_anchors,
)
from gsynopsis.training.view_step import train_view


class FullPhase:
    """Trains one part on all anchors; the topology is fixed once growth has ended."""

    name = "full"

    def __init__(self, steps: int, schedule_steps: int) -> None:
        """Let the learning rates end at `schedule_steps`; joint levels use the rest of them."""
        self.steps, self.schedule_steps = steps, schedule_steps
        # Weights are averaged at the end of the schedule; with joint levels that is a later phase.
        self.averages = steps == schedule_steps

    def begin(self, state: TrainState) -> None:
        """Count from zero."""
        model, context = state.model, state.context
        state.statistics = [
            GrowthStatistics.zeros(len(model), model.slots, context.renderer.device)
            for _ in context.group.shard(range(context.config.train.batch))
        ]

    def make_optimizer(self, state: TrainState) -> Optimizer:
        """One group per shared tensor and per weight of the heads; of a block its anchors alone."""
        model, context = state.model, state.context
        if context.region is None:
            parameters = shared_parameters(model)
            parameters |= part_parameters(model.part(-1), "", level_scale=False)
        else:
            parameters = row_parameters(model)
        free = context.config.model.feature == "free"
        return Optimizer(parameters, rates_of(parameters, context.rates, model.frame.extent, free))

    def step(self, state: TrainState) -> None:
        """A batch of views: train, count, and now and then grow and prune."""
        config, number = state.context.config, state.progress.step + 1
        growth = config.train.growth
        # The first steps move everything and say nothing of what is missing.
        counts = STATISTICS_FROM * self.steps < number < growth.until * self.steps
        # The schedule may go on in the joint phase, so it is not this phase's steps that count.
        progress = number / self.schedule_steps
        state.factor = reduced_factor(state, progress)
        for place, view in enumerate(synced_views(state, next_views(state))):
            counters = state.statistics[place] if counts else None
            train_view(state, state.model.part(-1), view, state.factor, counters=counters)
        state.optimizer.set_progress(progress)
        optimizer_step(state)
        # Slots need visits before they can be judged, so growth starts after counting does.
        late = ADJUST_FROM * self.steps < number < growth.until * self.steps
        if late and number % growth.every == 0:
            self._densify(state)

    def end(self, state: TrainState) -> None:
        """Prune floaters; the levels' training fills the holes they leave."""
        state.statistics = []
        part, trainable = state.model.part(-1), trainable_anchors(state)
        found = floaters(state.model, state.context.scene)
        part.mask = part.mask & ~(found if trainable is None else found & trainable)[:, None]

    def _densify(self, state: TrainState) -> None:
        """Grow and prune; deterministic across ranks: same statistics, same random numbers."""
        sync_losses(state)  # what diverged must not grow
        bring_home(state)
        context, group, trainable = state.context, state.context.group, trainable_anchors(state)
        frozen = 0 if trainable is None else int((~trainable).sum())
        growth = context.config.train.growth
        # In a block, frozen anchors of the others do not count against the limit by image size.
        growth = replace(growth, max_anchors=growth_limit(context.scene, context.config, frozen))
        total = merged(state.statistics, group)
        seeds = find_seeds(state.model, total, growth, state.generator, context.region)
        left = adjust(state.model, state.optimizer, total, growth, seeds, trainable)
        # What is not judged yet is counted once: in the first place of the first process.
        empty = [left.emptied() for _ in state.statistics]
        state.statistics = [left, *empty[1:]] if group.is_main else empty
