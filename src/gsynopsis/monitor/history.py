"""History of a training for pages and notebooks: steps, loss, held-out quality, time left."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gsynopsis.training.observer import StepInfo

POINTS = 200
"""Most points of the loss curve; beyond, every second one goes."""


@dataclass(frozen=True)
class Version:
    """Version of the scene that the page can load.

    Attributes:
        step: Steps done when it was packed, of all phases.
        bytes: Of its file.
        psnr: On held-out photos, dB; None if it was not measured.
        views: Held-out photos it was measured on.
    """

    step: int
    bytes: int
    psnr: float | None
    views: int


@dataclass(frozen=True)
class Snapshot:
    """A training as it stands.

    Attributes:
        step: Steps done, of all phases.
        loss: Smoothed as in `StepInfo`.
        psnr: Of the finest level on a few held-out photos, dB; None if none are held out.
        picture: The finest level from the first held-out photo's camera, uint8 [H, W, 3].
        photo: That photo, of the same size.
        curve: Steps and losses so far, 200 points at most.
    """

    step: int
    loss: float
    psnr: float | None
    picture: NDArray[np.uint8]
    photo: NDArray[np.uint8]
    curve: tuple[tuple[int, float], ...]


class TrainingHistory:
    """Collects what happens in the training's thread; `report` may be asked from another one.

    Attributes:
        curve: Steps and losses so far.
        version: What the page can load; None: nothing yet.
        finished: The training is over.
    """

    def __init__(self, phases: Sequence[tuple[str, int]]) -> None:
        """Nothing has happened; `phases` are name and steps of all, in order."""
        self._before: dict[str, int] = {}
        self._steps = 0
        for name, steps in phases:
            self._before[name] = self._steps
            self._steps += steps
        self._info: StepInfo | None = None
        self.curve: list[tuple[int, float]] = []
        self._stride = 1
        self.version: Version | None = None
        self.finished = False

    @property
    def step(self) -> int:
        """Steps done, of all phases; those of a run that goes on count too."""
        info = self._info
        return 0 if info is None else self._before.get(info.phase, 0) + info.step

    def add(self, info: StepInfo) -> None:
        """A step was done."""
        self._info = info
        step = self.step
        if step % self._stride == 0 and math.isfinite(info.loss):
            curve = [*self.curve, (step, round(info.loss, 6))]
            if len(curve) > POINTS:
                self._stride *= 2
                curve = curve[1::2]
            self.curve = curve

    def report(self) -> dict[str, object]:
        """Facts for JSON, None where unknown. Times are seconds, sizes bytes."""
        info, version, step = self._info, self.version, self.step
        held_out = None
        if version is not None and version.psnr is not None:
            held_out = {"psnr": version.psnr, "step": version.step, "views": version.views}
        return {
            "phase": info.phase if info else "",
            "step": step,
            "steps": self._steps,
            "loss": round(info.loss, 6) if info and math.isfinite(info.loss) else None,
            "held_out": held_out,
            "remaining": info and info.left,
            "finished": self.finished,
            "version": version and {"step": version.step, "bytes": version.bytes},
            "curve": self.curve,
        }
