"""Observer of a training: the contract between training and its displays."""

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class StepInfo:
    """One step of a loop.

    Attributes:
        phase: Name of the phase, e.g. `full`, `joint`, `unfold L2`.
        step: Steps done in this phase, from 1.
        steps: Steps of this phase.
        loss: Training loss, smoothed over about 50 steps.
        psnr: Training PSNR, dB, smoothed over about 50 steps.
        anchors: Present number of anchors.
        memory: Peak resident memory of this process (or of the GPU), bytes.
        left: Seconds until all phases are done, None if unknown.
    """

    phase: str
    step: int
    steps: int
    loss: float
    psnr: float
    anchors: int
    memory: int
    left: float | None = None


class Observer(Protocol):
    """Receives progress. Called after every step and view, so it has to return at once."""

    def on_step(self, info: StepInfo) -> None:
        """A step was done."""
        ...

    def on_pass(self, what: str, done: int, views: int) -> None:
        """Receive the progress of a pass over many views between two steps."""
        ...

    def on_message(self, text: str) -> None:
        """Something worth a line: a checkpoint written, a level hardened."""
        ...


class Silent:
    """An observer that ignores everything."""

    def on_step(self, info: StepInfo) -> None:
        """Ignore."""

    def on_pass(self, what: str, done: int, views: int) -> None:
        """Ignore."""

    def on_message(self, text: str) -> None:
        """Ignore."""
