"""A running training on a page: its state, packed now and then, served from a thread."""

import tempfile
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from gsynopsis.cli.training import pack_into
from gsynopsis.errors import GsynopsisError, MissingExtraError
from gsynopsis.train.progress import Observer, StepInfo

if TYPE_CHECKING:
    from gsynopsis.train.trainer import Trainer

LIVE_FILE = "live.gsyn"
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
    ) -> None:
        """Nothing is packed before the first steps are done.

        Args:
            observer: Is told of everything.
            pack: Writes the present state; its time is counted.
            clock: Seconds.
        """
        self._observer, self._pack, self._clock = observer, pack, clock
        self._due = clock() + SECONDS
        self._steps = 0
        self._told = ""

    def on_step(self, info: StepInfo) -> None:
        """Pass it on; pack if it is time."""
        self._observer.on_step(info)
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


@contextmanager
def showing(trainer: "Trainer", observer: Observer, port: int) -> Generator[Live]:
    """Serve a page that shows the trainer's model while the `with` lasts.

    Args:
        trainer: Its model is packed between steps.
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
    with tempfile.TemporaryDirectory(prefix="gsynopsis-") as name:
        folder = Path(name).resolve()
        app = make_app(Root(folder, LIVE_FILE), viewer=FOLDER)
        with serving(app, port=port) as address:
            observer.on_message(f"{address}/?content={LIVE_FILE}&live shows the training")
            yield Live(observer, lambda: pack_into(trainer, folder / LIVE_FILE, "compact"))
