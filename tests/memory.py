"""Memory that Python and NumPy take while a test does something."""

import tracemalloc
from collections.abc import Generator
from contextlib import contextmanager

TRACED = 5
"""Of so many repetitions one is traced: it takes four times as long as the others."""


@contextmanager
def at_most(limit: int) -> Generator[None]:
    """What is done meanwhile takes less than `limit` bytes at any time."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < limit
    finally:
        tracemalloc.stop()
