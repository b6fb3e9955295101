"""Ctrl-C and SIGTERM, asked between two steps of a job, or held until something is done."""

import signal
import threading
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


@contextmanager
def held_signals(*, masked: bool = False) -> Generator[None]:
    """Within it Ctrl-C and SIGTERM wait; at its end our own handlers get what came meanwhile.

    Outside of the main thread, where Python has no signals, nothing waits.

    Args:
        masked: Handlers that a library sets within do not get them either; processes that begin
            within get neither for good.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came, kinds = list[int](), (signal.SIGINT, signal.SIGTERM)
    before = {kind: signal.signal(kind, lambda number, _: came.append(number)) for kind in kinds}
    mask = getattr(signal, "pthread_sigmask", None) if masked else None  # Windows has none
    blocked = mask(signal.SIG_BLOCK, kinds) if mask else None
    try:
        yield
    finally:
        for kind, handler in before.items():
            signal.signal(kind, signal.SIG_DFL if handler is None else handler)
        if mask:
            mask(signal.SIG_SETMASK, blocked)
        for number in came:
            signal.raise_signal(number)
