"""What may stand in the log, and how much of it."""

import logging

from gsynopsis.serve.answer import Replaced
from gsynopsis.serve.log import LINE_MAX, LINES, LineFilter, plain, tame
from gsynopsis.serve.shaper import LinkCut


def record(text: str, error: BaseException | None = None) -> logging.LogRecord:
    info = (type(error), error, error.__traceback__) if error else None
    return logging.LogRecord("uvicorn.error", logging.ERROR, "", 0, text, None, info)


def test_control_characters_are_escaped() -> None:
    hostile = "a\nfake line\r\x1b[2J\x00\x7f\x9b\u202e\u2028\udcff é景"
    assert plain(hostile) == r"a\nfake line\r\x1b[2J\x00\x7f\x9b\u202e\u2028\udcff é景"
    assert len(plain("x" * 10_000)) == LINE_MAX


def test_an_error_is_one_line_with_its_place() -> None:
    try:
        raise OSError(5, "bad\nname")
    except OSError as error:
        found = record("Exception in ASGI application\n", error)
    assert LineFilter().filter(found)
    text = logging.Formatter().format(found)
    assert len(text.splitlines()) == 1
    assert r"OSError: [Errno 5] bad\nname (test_an_error_is_one" in text


def test_ends_that_are_meant_are_not_told() -> None:
    assert not LineFilter().filter(record("x", LinkCut()))
    assert not LineFilter().filter(record("x", Replaced()))


def test_a_minute_has_so_many_lines_and_no_more() -> None:
    now = [30.0]
    kept = LineFilter(lambda: now[0])
    lines = [
        r for r in (record("Invalid HTTP request received.") for _ in range(500)) if kept.filter(r)
    ]
    assert len(lines) == LINES
    assert lines[-1].getMessage().endswith("(nothing more in this minute)")
    now[0] = 70.0
    assert kept.filter(record("x"))


def test_a_logger_is_tamed_once() -> None:
    tame("gsynopsis.test")
    tame("gsynopsis.test")
    assert len(logging.getLogger("gsynopsis.test").filters) == 1
