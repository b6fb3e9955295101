"""Lines of the log: one for each event, without control characters, and not too many."""

import logging
import time
from collections.abc import Callable

from gsynopsis.serve.answer import Replaced
from gsynopsis.serve.shaper import LinkCut

EXPECTED = (LinkCut, Replaced)
"""Ends of connections that are meant, and not worth a line."""
LINES = 60
"""In a minute, at most."""
LINE_MAX = 500
"""Characters."""


def plain(text: str) -> str:
    """The text as it can be printed: control and other odd characters as escapes."""
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode()
        for c in text[:LINE_MAX]
    )


class LineFilter(logging.Filter):
    """Makes each record one short plain line; drops what comes beyond a number a minute."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Nothing was logged yet."""
        super().__init__()
        self._clock = clock
        self._minute, self._lines = -1, 0

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether it is printed; changes it."""
        error = record.exc_info[1] if record.exc_info else None
        if isinstance(error, EXPECTED):
            return False
        minute = int(self._clock() // 60)
        if minute != self._minute:
            self._minute, self._lines = minute, 0
        self._lines += 1
        text = record.getMessage().strip()
        if error is not None:
            text += f": {type(error).__name__}: {error}{_place(error)}"
        if self._lines == LINES:
            text += " (nothing more in this minute)"
        record.msg, record.args = plain(text), None
        record.exc_info = record.exc_text = record.stack_info = None
        return self._lines <= LINES


def _place(error: BaseException) -> str:
    """Where it was raised."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return f" ({trace.tb_frame.f_code.co_qualname}, line {trace.tb_lineno})" if trace else ""


def tame(*names: str) -> None:
    """Give these loggers the filter, once."""
    for name in names:
        logger = logging.getLogger(name)
        if not any(isinstance(known, LineFilter) for known in logger.filters):
            logger.addFilter(LineFilter())
