"""Starting points of a training: values that put into a run's folder what it begins from."""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from gsynopsis.training.checkpoint import begin_from
from gsynopsis.training.context import TrainContext
from gsynopsis.training.extend import extend_run
from gsynopsis.training.loop import CHECKPOINT, FULL


class Start(Protocol):
    """Starting point of a training whose folder has no checkpoint."""

    def prepare(self, context: TrainContext, out: Path) -> str:
        """Put it into the run's folder; a line for people, or ""."""
        ...


@dataclass(frozen=True)
class Fresh:
    """The scene's points; a finished run that is to have more steps goes on from its own."""

    def prepare(self, context: TrainContext, out: Path) -> str:
        """See `Start`."""
        return extend_run(out, context.scene.fingerprint(), context.config)


@dataclass(frozen=True)
class FromFullModel:
    """The full model of another run, whose levels are made another way.

    Attributes:
        checkpoint: State at the end of that run's full training.
    """

    checkpoint: Path

    def prepare(self, context: TrainContext, out: Path) -> str:
        """See `Start`."""
        if not (out / CHECKPOINT).exists():
            begin_from(context, self.checkpoint, out / FULL, out / CHECKPOINT)
        return ""
