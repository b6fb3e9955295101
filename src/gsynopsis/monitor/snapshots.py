"""Snapshots of a running training now and then: held-out quality, an image, the loss so far.

Nothing is drawn at random and nothing is trained, so that training goes on as without them.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol, runtime_checkable

import torch

from gsynopsis.errors import GsynopsisError
from gsynopsis.evaluation.evaluate import evenly
from gsynopsis.evaluation.metrics import Image8, psnr, to_bytes
from gsynopsis.monitor.history import Snapshot, TrainingHistory
from gsynopsis.training.loop import phases_of
from gsynopsis.training.observer import Silent, StepInfo
from gsynopsis.training.state import TrainState, bring_home

HELD_OUT = 2
"""Photos on which quality is measured meanwhile."""
SHARE = 0.05
"""Largest share of the training's time that goes into snapshots."""
SECONDS = 5.0
"""Least time between two snapshots."""


@runtime_checkable
class SnapshotListener(Protocol):
    """Shows or writes snapshots, as a notebook or TensorBoard does."""

    def on_snapshot(self, snapshot: Snapshot) -> None:
        """A snapshot was taken."""
        ...


class SnapshotObserver(Silent):
    """An observer that takes a snapshot of the training now and then."""

    def __init__(
        self,
        take: Callable[[], tuple[float | None, Image8, Image8]],
        listeners: Sequence[SnapshotListener],
        history: TrainingHistory,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Nothing is taken before the first seconds have passed, or a phase is over.

        Args:
            take: Gives held-out PSNR, an image and its photo; its time is counted.
            listeners: Hear of each snapshot.
            history: Hears of the steps.
            clock: Seconds.
        """
        self._take, self._listeners = take, listeners
        self._history, self._clock = history, clock
        self._due = clock() + SECONDS

    def on_step(self, info: StepInfo) -> None:
        """Note it; take a snapshot if it is time."""
        self._history.add(info)
        begun = self._clock()
        if begun < self._due and info.step < info.steps:
            return
        try:
            quality, image, photo = self._take()
        except GsynopsisError:  # whatever is wrong, the training itself says so
            return
        curve = tuple(self._history.curve)
        snapshot = Snapshot(self._history.step, info.loss, quality, image, photo, curve)
        for listener in self._listeners:
            listener.on_snapshot(snapshot)
        ended = self._clock()
        self._due = ended + max(SECONDS, (ended - begun) / SHARE)


def snapshots_of(state: TrainState, listeners: Sequence[SnapshotListener]) -> SnapshotObserver:
    """An observer that gives snapshots of this training to `listeners`."""
    phases = [(phase.name, phase.steps) for phase in phases_of(state.context.config)]
    return SnapshotObserver(lambda: take_snapshot(state), listeners, TrainingHistory(phases))


def take_snapshot(state: TrainState) -> tuple[float | None, Image8, Image8]:
    """Held-out PSNR (see `held_out_psnr`), the first held-out view, and its photo.

    Raises:
        SceneError: a photo cannot be read.
        DivergedError: a pixel is not finite.
    """
    scene, scale = state.context.scene, state.context.config.scale
    view = scene.test[0]
    image = _rendered(state, view)
    return held_out_psnr(state, {view: image}), image, scene.image(view, scale)


def held_out_psnr(state: TrainState, rendered: Mapping[int, Image8] | None = None) -> float | None:
    """PSNR of the finest level on a few held-out photos, dB; None if none are held out.

    Args:
        state: State of the training.
        rendered: Views that are rendered already.

    Raises:
        SceneError: a photo cannot be read.
        DivergedError: a pixel is not finite.
    """
    scene, scale = state.context.scene, state.context.config.scale
    if set(scene.test) & set(scene.train):
        return None
    known, found = rendered or {}, list[float]()
    for view in evenly(scene.test, HELD_OUT):
        image = known[view] if view in known else _rendered(state, view)
        found.append(psnr(image, scene.image(view, scale)))
    return round(sum(found) / len(found), 3)


def _rendered(state: TrainState, view: int) -> Image8:
    bring_home(state)
    context, model = state.context, state.model
    camera = context.scene.camera(view, context.config.scale)
    with torch.no_grad():
        rendering = context.renderer.render(model.decode(camera), camera, state.background)
    return to_bytes(rendering.image)
