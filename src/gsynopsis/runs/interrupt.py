"""Ctrl-C and SIGTERM as a question that a long job answers between two steps."""

import signal
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any


@contextmanager
def stop_on_interrupt(*, alone: bool = True) -> Generator[Callable[[], bool]]:
    """Within it Ctrl-C or SIGTERM asks to stop; the same one again interrupts at once.

    Not so under torchrun (`alone` false), which may repeat a signal and kills whoever is too slow.
    Outside of the main thread, where Python has no signals, nothing is caught.
    """
    asked = set[int]()

    def ask(number: int, frame: object) -> None:
        if number in asked and alone:
            raise KeyboardInterrupt
        asked.add(number)

    before: dict[signal.Signals, Any] = {}
    try:
        for kind in (signal.SIGINT, signal.SIGTERM):
            before[kind] = signal.signal(kind, ask)
    except ValueError:
        pass
    try:
        yield lambda: bool(asked)
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)
