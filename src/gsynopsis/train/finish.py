"""The finish: networks, codebooks and gains adapt to what a reader of the file will get (ours).

Coordinates, scales, offsets, features and grids take the values that the packed file gives back,
and stay there; what each level owns is trained a little further against them.
"""

import torch

from gsynopsis.model.anchors import AnchorModel
from gsynopsis.model.build import model_from_levels, model_to_levels
from gsynopsis.train.optimiser import Optimiser
from gsynopsis.train.trainer import Trainer, level_parameters, rates_of

START = 0.02
"""Rates begin at this share of their initial ones: the networks are nearly right."""


class FinishPhase:
    """A short training of every level's own parts against decoded shared tensors."""

    name = "finish"
    settles = True

    def __init__(self, steps: int) -> None:
        """Steps of `levels.together` levels each."""
        self.steps = steps

    def begin(self, trainer: Trainer) -> None:
        """Replace the model by what the file would give, but keep networks unrounded."""
        assert trainer.model is not None
        if trainer.packer is None:
            return
        settled = model_from_levels(trainer.packer.settle(model_to_levels(trainer.model, {})))
        trainer.adopt(_with_parts_of(settled, trainer.model))

    def make_optimiser(self, trainer: Trainer) -> Optimiser:
        """What each level owns; nothing that levels share."""
        assert trainer.model is not None
        parameters = level_parameters(trainer.model, trainer.config.levels.gain)
        free = trainer.config.model.feature == "free"
        extent = trainer.model.frame.extent
        rates = rates_of(parameters, trainer.config.train.rates, extent, free)
        return Optimiser(
            parameters, {n: (a * START, min(b, a * START)) for n, (a, b) in rates.items()}
        )

    def step(self, trainer: Trainer) -> None:
        """A batch of views at a few levels drawn at random, their gradients added."""
        assert trainer.optimiser is not None and trainer.model is not None
        count = len(trainer.model.parts)
        together = min(trainer.config.levels.together, count)
        views = trainer.next_views()
        drawn = trainer.rng.choice(count, size=together, replace=False)
        for view in trainer.batch(views):
            trainer.learn_levels(drawn, view)
        trainer.optimiser.set_progress((trainer.cursor.step + 1) / self.steps)
        trainer.optimiser.step()

    def end(self, trainer: Trainer) -> None:
        """Nothing is left to do."""


def _with_parts_of(settled: AnchorModel, model: AnchorModel) -> AnchorModel:
    """A decoded model with the networks, codebooks and gains of the one that was packed."""
    with torch.no_grad():
        for number in range(len(settled.parts)):
            part, source = settled.part(number), model.part(number)
            part.codebook.copy_(source.codebook)
            part.log_gain.copy_(source.log_gain)
            for name, weight in source.networks.items():
                part.networks[name].copy_(weight)
    return settled
