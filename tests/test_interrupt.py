"""Ctrl-C and SIGTERM that wait until something is done."""

import signal
import threading
import time

import pytest

from gsynopsis.interrupt import held_signals


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_the_library_is_loaded_is_ours(kind: signal.Signals) -> None:
    """Its import took Ctrl-C for a broken installation; its own handler of SIGTERM hung."""
    came = list[int]()
    before = signal.signal(kind, lambda number, frame: came.append(number))
    try:
        with held_signals(masked=True):
            signal.pthread_kill(threading.get_ident(), kind)
            time.sleep(0.01)
            signal.signal(signal.SIGTERM, lambda number, frame: came.append(-1))  # as it does
            assert not came
        assert came == [kind]
    finally:
        signal.signal(kind, before)
