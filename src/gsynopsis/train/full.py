"""The full model: the finest level, with growing and pruning (methods.md §1.7–§1.10)."""

import torch

from gsynopsis.model.build import new_model
from gsynopsis.train.growth import (
    ADJUST_FROM,
    STATISTICS_FROM,
    GrowthStatistics,
    adjust,
    find_seeds,
    merged,
)
from gsynopsis.train.optimiser import Optimiser
from gsynopsis.train.trainer import (
    Outcome,
    Trainer,
    part_parameters,
    rates_of,
    shared_parameters,
)


class FullPhase:
    """Trains one part on all anchors; the topology is fixed after half of the steps."""

    name = "full"

    def __init__(self, steps: int, schedule_steps: int) -> None:
        """`schedule_steps` is where the learning rates end; joint levels use the rest of it."""
        self.steps, self.schedule_steps = steps, schedule_steps
        self.settles = steps == schedule_steps

    def begin(self, trainer: Trainer) -> None:
        """Build the model from the scene's points."""
        model = new_model(trainer.scene, trainer.config.model, trainer.generator)
        trainer.adopt(model)
        trainer.statistics = [
            GrowthStatistics.zeros(len(model), model.slots, trainer.renderer.device)
            for _ in trainer.world.share(range(trainer.config.train.batch))
        ]

    def make_optimiser(self, trainer: Trainer) -> Optimiser:
        """One group per shared tensor and per weight of the heads."""
        assert trainer.model is not None
        parameters = shared_parameters(trainer.model)
        parameters |= part_parameters(trainer.model.part(-1), "", gain=False)
        free = trainer.config.model.feature == "free"
        rates = rates_of(parameters, trainer.rates, trainer.model.frame.extent, free)
        return Optimiser(parameters, rates)

    def step(self, trainer: Trainer) -> None:
        """A batch of views: learn, count, and now and then grow and prune."""
        assert trainer.model is not None and trainer.optimiser is not None
        number = trainer.cursor.step + 1
        growth = trainer.config.train.growth
        counts = STATISTICS_FROM * self.steps < number < growth.until * self.steps
        for place, view in enumerate(trainer.batch(trainer.next_views())):
            outcome = trainer.forward(trainer.model.part(-1), view, trainer.config.scale)
            trainer.learn(outcome.loss, outcome, view)
            if counts:
                self._count(trainer, outcome, view, trainer.statistics[place])
        trainer.optimiser.set_progress(number / self.schedule_steps)
        trainer.optimiser.step()
        late = ADJUST_FROM * self.steps < number < growth.until * self.steps
        if late and number % growth.every == 0:
            self._adjust(trainer)

    def end(self, trainer: Trainer) -> None:
        """Statistics are not needed any more."""
        trainer.statistics = []

    def _count(
        self, trainer: Trainer, outcome: Outcome, view: int, statistics: GrowthStatistics
    ) -> None:
        camera = trainer.scene.camera(view, trainer.config.scale)
        drawn = outcome.rendering
        size = torch.tensor([camera.width, camera.height], device=trainer.renderer.device)
        statistics.observe(outcome.decoded, drawn.screen_grad(), drawn.visible, size)

    def _adjust(self, trainer: Trainer) -> None:
        """All processes see the same statistics and draw the same luck, so all decide alike."""
        assert trainer.model is not None and trainer.optimiser is not None
        growth = trainer.config.train.growth
        seen = merged(trainer.statistics, trainer.world)
        seeds = find_seeds(trainer.model, seen, growth, trainer.generator)
        left = adjust(trainer.model, trainer.optimiser, seen, growth, seeds)
        # What is not judged yet is counted once: in the first place of the first process.
        empty = [left.emptied() for _ in trainer.statistics]
        trainer.statistics = [left, *empty[1:]] if trainer.world.leads else empty
