"""One look at a head refuses what the application refuses, with the same answer."""

import h11
import pytest
from starlette.datastructures import Headers

from gsynopsis.serve.refusal import EVERYWHERE, has_body, is_whole, refusal, refused_at_once

HEADERS: dict[str, bool] = {
    "Content-Length: 1": True,
    "content-length:1000000000": True,
    "CONTENT-LENGTH: \t007": True,
    "Transfer-Encoding: chunked": True,
    "Content-Length: 0": False,
    "Content-Length: 000": False,
    "X-Content-Length: 5": False,
    "X: content-length: 5": False,
    "Range: bytes=0-99": False,
}


def head(method: str, *lines: str, end: str = "\r\n") -> bytes:
    return (end.join([f"{method} /a.gsyn HTTP/1.1", "Host: a", *lines]) + end * 2).encode()


@pytest.mark.parametrize("end", ["\r\n", "\n"])
@pytest.mark.parametrize("line", HEADERS)
def test_it_finds_what_the_application_finds(line: str, end: str) -> None:
    name, _, value = line.partition(":")
    assert has_body(Headers({name: value.strip()})) == HEADERS[line]
    found = refused_at_once(head("GET", line, end=end))
    assert (found is not None) == HEADERS[line]


@pytest.mark.parametrize("method", ["GET", "HEAD", "OPTIONS", "POST", "PUT", "ODD"])
def test_the_bytes_are_those_of_the_answer(method: str) -> None:
    found = refused_at_once(head(method, "Content-Length: 5") + b"12345")
    assert found is not None
    start, _, body = found.partition(b"\r\n\r\n")
    first, *lines = start.decode().split("\r\n")
    slow = refusal(method)
    assert first.startswith(f"HTTP/1.1 {slow.status_code} ")
    got = dict(line.split(": ", 1) for line in lines)
    assert got.pop("date").endswith(" GMT")
    assert got == dict(slow.headers) and got.items() >= EVERYWHERE.items()
    assert body == (b"" if method == "HEAD" else slow.body)


def test_nothing_is_refused_before_its_head_is_whole_nor_for_what_follows_it() -> None:
    data = head("POST", "Content-Length: 5")
    assert all(refused_at_once(data[:n]) is None for n in range(len(data)))
    assert not any(is_whole(data[:n]) for n in range(len(data))) and is_whole(data)
    assert refused_at_once(head("GET") + data) is None


@pytest.mark.parametrize(
    ("line", "right"),
    [
        (b"GET /a.gsyn HTTP/1.1", True),
        (b"ODD!#$%&'*+-.^_`|~ * HTTP/1.0", True),
        (b"GET http://a/%20?b HTTP/1.1", True),
        (b"GET /a.gsyn", False),
        (b"nonsense", False),
        (b"GET  /a HTTP/1.1", False),
        (b"GET /a b HTTP/1.1", False),
        (b"\x16\x03\x01\x02", False),
        (b"", False),
    ],
)
def test_what_is_no_request_is_refused_and_whatever_h11_takes_is_not(
    line: bytes, right: bool
) -> None:
    data = line + b"\r\nHost: a\r\n\r\n"
    parser = h11.Connection(h11.SERVER)
    parser.receive_data(data)
    if right:
        assert isinstance(parser.next_event(), h11.Request)
    else:
        with pytest.raises(h11.RemoteProtocolError):
            parser.next_event()
    found = refused_at_once(data)
    assert found is None if right else found is not None and found.startswith(b"HTTP/1.1 400 ")
