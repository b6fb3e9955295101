"""A look at a running training now and then: held-out quality, a picture, and the loss so far.

Nothing is drawn at random and nothing is learnt, so that training goes on as without it.
"""

import time
from collections.abc import Callable, Mapping, Sequence

import torch

from gsynopsis.errors import GsynopsisError
from gsynopsis.evaluation.evaluate import evenly
from gsynopsis.evaluation.metrics import Image8, psnr, to_bytes
from gsynopsis.monitor.history import Course, Glimpse
from gsynopsis.training.loop import phases_of
from gsynopsis.training.observer import Observer, StepInfo
from gsynopsis.training.state import TrainState

HELD_OUT = 2
"""Photos on which quality is measured meanwhile."""
SHARE = 0.05
"""Of the training's time, at most, goes into looks."""
SECONDS = 5.0
"""Between two looks, at least."""


Taker = Callable[[Glimpse], None]


class Previewing:
    """An observer that looks at the training now and then, and tells another one of all else."""

    def __init__(
        self,
        observer: Observer,
        look: Callable[[], tuple[float | None, Image8, Image8]],
        takers: Sequence[Taker],
        course: Course,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Nothing is looked at before the first seconds have passed, or a phase is over.

        Args:
            observer: Is told of everything.
            look: Gives held-out PSNR, a picture and its photo; its time is counted.
            takers: Are given what it sees.
            course: Is told of the steps.
            clock: Seconds.
        """
        self._observer, self._look, self._takers = observer, look, takers
        self._course, self._clock = course, clock
        self._due = clock() + SECONDS

    def on_step(self, info: StepInfo) -> None:
        """Pass it on; look if it is time."""
        self._observer.on_step(info)
        self._course.add(info)
        begun = self._clock()
        if begun < self._due and info.step < info.steps:
            return
        try:
            quality, picture, photo = self._look()
        except GsynopsisError:  # whatever is wrong, the training itself says so
            return
        curve = tuple(self._course.curve)
        glimpse = Glimpse(self._course.step, info.loss, quality, picture, photo, curve)
        for take in self._takers:
            take(glimpse)
        ended = self._clock()
        self._due = ended + max(SECONDS, (ended - begun) / SHARE)

    def on_pass(self, what: str, done: int, views: int) -> None:
        """Pass it on."""
        self._observer.on_pass(what, done, views)

    def on_message(self, text: str) -> None:
        """Pass it on."""
        self._observer.on_message(text)


def previewing(state: TrainState, observer: Observer, takers: Sequence[Taker]) -> Observer:
    """An observer of a training that gives what it sees to `takers`; itself if there are none."""
    if not takers or not state.setup.world.leads:
        return observer
    course = Course([(phase.name, phase.steps) for phase in phases_of(state.setup.config)])
    return Previewing(observer, lambda: look_at(state), takers, course)


def look_at(state: TrainState) -> tuple[float | None, Image8, Image8]:
    """Held-out PSNR (see `held_out_psnr`), the first held-out view, and its photo.

    Raises:
        SceneError: a photo cannot be read.
        DivergedError: a pixel is not finite.
    """
    scene, scale = state.setup.scene, state.setup.config.scale
    view = scene.test[0]
    drawn = _drawn(state, view)
    return held_out_psnr(state, {view: drawn}), drawn, scene.image(view, scale)


def held_out_psnr(state: TrainState, drawn: Mapping[int, Image8] | None = None) -> float | None:
    """PSNR of the finest level on a few held-out photos, dB; None if none are held out.

    Args:
        state: Of the training.
        drawn: Views of it that are drawn already.

    Raises:
        SceneError: a photo cannot be read.
        DivergedError: a pixel is not finite.
    """
    scene, scale = state.setup.scene, state.setup.config.scale
    if set(scene.test) & set(scene.train):
        return None
    known, found = drawn or {}, list[float]()
    for view in evenly(scene.test, HELD_OUT):
        picture = known[view] if view in known else _drawn(state, view)
        found.append(psnr(picture, scene.image(view, scale)))
    return round(sum(found) / len(found), 3)


def _drawn(state: TrainState, view: int) -> Image8:
    setup, model = state.setup, state.model
    camera = setup.scene.camera(view, setup.config.scale)
    with torch.no_grad():
        drawn = setup.renderer.render(model.decode(camera), camera, state.background)
    return to_bytes(drawn.image)
