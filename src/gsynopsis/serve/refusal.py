"""Requests that announce a body or are none: refused before an application is asked.

Who sends such requests sends them again and again, so the answer has a fast form: bytes found by
one look at the head. Whatever that look does not find goes the long way, to the same answer.
"""

import re
from email.utils import formatdate
from functools import lru_cache
from http import HTTPStatus
from time import time

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse, Response

SEALED = "default-src 'none'"
"""What is no page may do nothing where somebody takes it for one."""
EVERYWHERE = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "content-security-policy": SEALED,
}
"""Headers of every answer that has none of its own."""
KNOWN = ("GET", "HEAD", "OPTIONS")
"""Methods that we have; with a body they are bad requests, others are not allowed."""
HEAD_END = re.compile(rb"\n\r?\n")
REQUEST_LINE = re.compile(rb"[^ \r\n]+ [^ \r\n]+ HTTP/\d\.\d\r?\n")
"""Whatever h11 takes for one, and some more."""
ANNOUNCED = re.compile(rb"\n(?:content-length:[ \t]*0*[1-9]|transfer-encoding:)", re.IGNORECASE)


def sealed(answer: Response) -> Response:
    """The same with the headers that every answer has."""
    for name, value in EVERYWHERE.items():
        answer.headers.setdefault(name, value)
    return answer


def not_allowed() -> Response:
    """For methods that we do not have."""
    return PlainTextResponse("GET or HEAD", 405, {"allow": "GET, HEAD"})


def has_body(headers: Headers) -> bool:
    """The request says that something comes after its head."""
    return "transfer-encoding" in headers or headers.get("content-length", "0").strip("0 ") != ""


def refusal(method: str) -> Response:
    """For a request that has a body; the connection ends.

    What is still to come would be taken for a request.
    """
    answer = PlainTextResponse("a body is refused", 400) if method in KNOWN else not_allowed()
    answer.headers["connection"] = "close"
    return sealed(answer)


def _halves(answer: Response, *, body: bool = True) -> tuple[bytes, bytes]:
    """An answer as it is sent: up to its last header, and from there."""
    reason = HTTPStatus(answer.status_code).phrase.encode()
    head = b"HTTP/1.1 %d %s\r\n" % (answer.status_code, reason)
    lines = b"".join(b"%s: %s\r\n" % header for header in answer.raw_headers)
    return head + lines, b"\r\n" + (bytes(answer.body) if body else b"")


_KNOWN = {method.encode(): _halves(refusal(method), body=method != "HEAD") for method in KNOWN}
_OTHER = _halves(refusal("POST"))
_INVALID = _halves(sealed(PlainTextResponse("no HTTP", 400, {"connection": "close"})))


@lru_cache(1)
def _date(seconds: int) -> bytes:
    return b"date: %s\r\n" % formatdate(seconds, usegmt=True).encode()


def invalid() -> bytes:
    """The whole answer to what is no HTTP."""
    return _INVALID[0] + _date(int(time())) + _INVALID[1]


def is_whole(data: bytes) -> bool:
    """A request's head has come to its end."""
    return HEAD_END.search(data) is not None


def refused_at_once(data: bytes) -> bytes | None:
    """The whole answer to a request that announces a body, or to what is no request.

    Args:
        data: What has come of a request and of those behind it.

    Returns:
        None if the first head is not whole, or is right as far as one look shows.
    """
    end = HEAD_END.search(data)
    if end is not None and not REQUEST_LINE.match(data):
        return invalid()
    if end is None or not ANNOUNCED.search(data, 0, end.end()):
        return None
    head, rest = _KNOWN.get(data.partition(b" ")[0], _OTHER)
    return head + _date(int(time())) + rest
