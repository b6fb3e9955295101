"""The full model: the finest level, with growing and pruning (methods.md §1.7–§1.10)."""

from dataclasses import replace

from gsynopsis.training.growth import (
    ADJUST_FROM,
    STATISTICS_FROM,
    GrowthStatistics,
    adjust,
    find_seeds,
    merged,
    most_grown,
)
from gsynopsis.training.optim.adam import Optimiser
from gsynopsis.training.optim.param_groups import (
    part_parameters,
    rates_of,
    row_parameters,
    shared_parameters,
)
from gsynopsis.training.regularize.floaters import floaters
from gsynopsis.training.state import Outcome, TrainState


class FullPhase:
    """Trains one part on all anchors; the topology is fixed once growth has ended."""

    name = "full"

    def __init__(self, steps: int, schedule_steps: int) -> None:
        """`schedule_steps` is where the learning rates end; joint levels use the rest of it."""
        self.steps, self.schedule_steps = steps, schedule_steps
        self.averages = steps == schedule_steps

    def begin(self, state: TrainState) -> None:
        """Count from zero."""
        model, setup = state.model, state.setup
        state.statistics = [
            GrowthStatistics.zeros(len(model), model.slots, setup.renderer.device)
            for _ in setup.world.share(range(setup.config.train.batch))
        ]

    def make_optimiser(self, state: TrainState) -> Optimiser:
        """One group per shared tensor and per weight of the heads; of a block its anchors alone."""
        model, setup = state.model, state.setup
        if setup.region is None:
            parameters = shared_parameters(model)
            parameters |= part_parameters(model.part(-1), "", level_scale=False)
        else:
            parameters = row_parameters(model)
        free = setup.config.model.feature == "free"
        return Optimiser(parameters, rates_of(parameters, setup.rates, model.frame.extent, free))

    def step(self, state: TrainState) -> None:
        """A batch of views: learn, count, and now and then grow and prune."""
        config, number = state.setup.config, state.cursor.step + 1
        growth = config.train.growth
        counts = STATISTICS_FROM * self.steps < number < growth.until * self.steps
        for place, view in enumerate(state.batch(state.next_views())):
            outcome = state.study(state.model.part(-1), view, config.scale)
            if counts:
                self._count(state, outcome, view, state.statistics[place])
        state.optimiser.set_progress(number / self.schedule_steps)
        state.move()
        late = ADJUST_FROM * self.steps < number < growth.until * self.steps
        if late and number % growth.every == 0:
            self._adjust(state)

    def end(self, state: TrainState) -> None:
        """Prune floaters; the levels' training closes what they hid."""
        state.statistics = []
        part, moving = state.model.part(-1), state.moving()
        found = floaters(state.model, state.setup.scene)
        part.mask = part.mask & ~(found if moving is None else found & moving)[:, None]

    def _count(
        self, state: TrainState, outcome: Outcome, view: int, statistics: GrowthStatistics
    ) -> None:
        setup, rendering = state.setup, outcome.rendering
        camera = setup.scene.camera(view, setup.config.scale)
        size = camera.width, camera.height
        statistics.observe(outcome.decoded, rendering.screen_grad(), rendering.visible, size)

    def _adjust(self, state: TrainState) -> None:
        """All processes see the same statistics and draw the same luck, so all decide alike."""
        state.read_losses()  # what diverged must not grow
        setup, world, moving = state.setup, state.setup.world, state.moving()
        still = 0 if moving is None else int((~moving).sum())
        growth = setup.config.train.growth
        growth = replace(growth, max_anchors=most_grown(setup.scene, setup.config, still))
        total = merged(state.statistics, world)
        seeds = find_seeds(state.model, total, growth, state.generator, setup.region)
        left = adjust(state.model, state.optimiser, total, growth, seeds, moving)
        # What is not judged yet is counted once: in the first place of the first process.
        empty = [left.emptied() for _ in state.statistics]
        state.statistics = [left, *empty[1:]] if world.leads else empty
