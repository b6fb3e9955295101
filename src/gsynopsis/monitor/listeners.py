"""Several observers as one."""

from collections.abc import Sequence

from gsynopsis.monitor.eta import TimeLeft
from gsynopsis.training.observer import Observer, StepInfo


class Listeners:
    """Observers in order; each step reaches them with the time that is left."""

    def __init__(self, observers: Sequence[Observer], time_left: TimeLeft | None = None) -> None:
        """`time_left` adds the time until all phases are done; None: nobody knows."""
        self._observers, self._time_left = observers, time_left

    def on_step(self, info: StepInfo) -> None:
        """Pass it on, with the time left; early in each phase that is a line."""
        line = ""
        if self._time_left is not None:
            info, line = self._time_left.add(info)
        for observer in self._observers:
            observer.on_step(info)
        if line:
            self.on_message(line)

    def on_pass(self, what: str, done: int, views: int) -> None:
        """Pass it on."""
        for observer in self._observers:
            observer.on_pass(what, done, views)

    def on_message(self, text: str) -> None:
        """Pass it on."""
        for observer in self._observers:
            observer.on_message(text)
