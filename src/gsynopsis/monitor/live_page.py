"""A running training on a page: its state, packed now and then, served from a thread."""

import tempfile
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from gsynopsis.errors import GsynopsisError, MissingExtraError
from gsynopsis.monitor.history import Course, Version
from gsynopsis.training.observer import Observer, StepInfo

if TYPE_CHECKING:
    from gsynopsis.training.state import TrainState

LIVE_FILE = "live.gsyn"
LIVE_REPORT = "live.json"
"""Beside the file: how the training goes."""
SHARE = 0.05
"""Of the training's time, at most, goes into packing for the page."""
SECONDS = 5.0
"""Between two versions, at least: the page decodes each of them."""
FIRST_STEPS = 20
"""Before them there is nothing to see."""


class Live:
    """An observer that packs the model between steps, and tells another one of all that happens."""

    def __init__(
        self,
        observer: Observer,
        pack: Callable[[], object],
        clock: Callable[[], float] = time.monotonic,
        course: Course | None = None,
    ) -> None:
        """Nothing is packed before the first steps are done.

        Args:
            observer: Is told of everything.
            pack: Writes the present state; its time is counted.
            clock: Seconds.
            course: Is told of the steps, too.
        """
        self._observer, self._pack, self._clock = observer, pack, clock
        self.course = course or Course(())
        self._due = clock() + SECONDS
        self._steps = 0
        self._told = ""

    def on_step(self, info: StepInfo) -> None:
        """Pass it on; pack if it is time."""
        self._observer.on_step(info)
        self.course.add(info)
        self._steps += 1
        if self._steps >= FIRST_STEPS and self._clock() >= self._due:
            self.pack()

    def on_pass(self, what: str, done: int, views: int) -> None:
        """Pass it on."""
        self._observer.on_pass(what, done, views)

    def on_message(self, text: str) -> None:
        """Pass it on."""
        self._observer.on_message(text)

    def pack(self) -> None:
        """Pack now. A failure is told once and never ends the training."""
        begun = self._clock()
        try:
            self._pack()
        except (GsynopsisError, OSError) as error:
            if str(error) != self._told:
                self._told = str(error)
                self._observer.on_message(f"the page shows nothing new: {error}")
        ended = self._clock()
        self._due = ended + max(SECONDS, (ended - begun) / SHARE)

    def finish(self) -> None:
        """The training is over: pack its result."""
        self.course.finished = True
        self.pack()


@contextmanager
def showing(state: "TrainState", preset: str, observer: Observer, port: int) -> Generator[Live]:
    """Serve a page that shows the model of a training while the `with` lasts.

    Args:
        state: Its model is packed between steps.
        preset: Name of its preset.
        observer: Told of everything, and of the address.
        port: To listen on, on this machine only; 0 takes a free one.

    Raises:
        InputError: the port is not to be had.
        MissingExtraError: the server is not installed.
    """
    try:
        from gsynopsis.serve.app import make_app
        from gsynopsis.serve.files import Root
        from gsynopsis.serve.page import FOLDER
        from gsynopsis.serve.run import serving
    except ImportError as error:
        raise MissingExtraError("starlette and uvicorn", "serve,stream") from error
    from gsynopsis.jobs.write_file import write_draft
    from gsynopsis.monitor.snapshots import HELD_OUT, held_out_psnr
    from gsynopsis.training.loop import phases_of

    course = Course([(phase.name, phase.steps) for phase in phases_of(state.setup.config)])

    with tempfile.TemporaryDirectory(prefix="gsynopsis-") as name:
        folder = Path(name).resolve()
        root, reports = Root(folder, LIVE_FILE), {LIVE_REPORT: course.report}
        app = make_app(root, viewer=FOLDER, reports=reports)

        def pack() -> None:
            path = folder / LIVE_FILE
            write_draft(state, preset, path)
            quality, size = held_out_psnr(state), path.stat().st_size
            views = min(HELD_OUT, len(state.setup.scene.test))
            course.version = Version(course.step, size, quality, views)

        with serving(app, port=port) as address:
            observer.on_message(f"{address}/?content={LIVE_FILE}&live shows the training")
            yield Live(observer, pack, course=course)
