"""A page that shows a running training: its levels, packed now and then, served from a thread."""

import tempfile
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path

from gsynopsis.errors import GsynopsisError, MissingExtraError
from gsynopsis.monitor.history import TrainingHistory, Version
from gsynopsis.monitor.snapshots import HELD_OUT, held_out_psnr
from gsynopsis.training.loop import phases_of
from gsynopsis.training.observer import Observer, Silent, StepInfo
from gsynopsis.training.state import TrainState

LIVE_FILE = "live.gsyn"
LIVE_REPORT = "live.json"
"""Name beside the file of the training's history."""
SHARE = 0.05
"""Largest share of the training's time that goes into packing for the page."""
SECONDS = 5.0
"""Least time between two versions: the page decodes each of them."""
FIRST_STEPS = 20
"""Steps before which there is nothing to see."""


class LivePage(Silent):
    """An observer that packs the model between steps.

    Attributes:
        history: Steps and losses so far, for the page.
    """

    def __init__(
        self,
        pack: Callable[[], object],
        tell: Callable[[str], None],
        history: TrainingHistory | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Pack nothing before the first steps are done.

        Args:
            pack: Writes the present levels; its time is counted.
            tell: Hears why packing failed.
            history: Hears of the steps.
            clock: Seconds.
        """
        self._pack, self._emit, self._clock = pack, tell, clock
        self.history = history or TrainingHistory(())
        self._due = clock() + SECONDS
        self._steps = 0
        self._failure = ""

    def on_step(self, info: StepInfo) -> None:
        """Note it; pack if it is time."""
        self.history.add(info)
        self._steps += 1
        if self._steps >= FIRST_STEPS and self._clock() >= self._due:
            self.pack()

    def pack(self) -> None:
        """Pack now. A failure is one message and never ends the training."""
        begun = self._clock()
        try:
            self._pack()
        except (GsynopsisError, OSError) as error:
            if str(error) != self._failure:
                self._failure = str(error)
                self._emit(f"the page shows nothing new: {error}")
        ended = self._clock()
        self._due = ended + max(SECONDS, (ended - begun) / SHARE)

    def finish(self) -> None:
        """Pack the result: the training is over."""
        self.history.finished = True
        self.pack()


@contextmanager
def live_page(
    state: TrainState, pack: Callable[[Path], None], port: int, observer: Observer
) -> Generator[LivePage]:
    """Serve a page that shows the model of a training while the `with` lasts.

    Args:
        state: Its model is shown.
        pack: Writes the present levels of the training to a path.
        port: To listen on, on this machine only; 0 takes a free one.
        observer: Hears the address.

    Raises:
        InputError: the port is taken.
        MissingExtraError: the server is not installed.
    """
    try:
        from gsynopsis.serve.app import make_app
        from gsynopsis.serve.files import Root
        from gsynopsis.serve.page import FOLDER
        from gsynopsis.serve.run import serving
    except ImportError as error:
        raise MissingExtraError("starlette and uvicorn", "serve,stream") from error
    history = TrainingHistory([(p.name, p.steps) for p in phases_of(state.context.config)])

    with tempfile.TemporaryDirectory(prefix="gsynopsis-") as name:
        folder = Path(name).resolve()
        root, reports = Root(folder, LIVE_FILE), {LIVE_REPORT: history.report}
        app = make_app(root, viewer=FOLDER, reports=reports)

        def pack_version() -> None:
            path = folder / LIVE_FILE
            pack(path)
            quality, size = held_out_psnr(state), path.stat().st_size
            views = min(HELD_OUT, len(state.context.scene.test))
            history.version = Version(history.step, size, quality, views)

        with serving(app, port=port) as address:
            observer.on_message(f"{address}/?content={LIVE_FILE}&live shows the training")
            yield LivePage(pack_version, observer.on_message, history)
