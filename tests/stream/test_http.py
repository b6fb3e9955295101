import gzip
import re
import ssl
import tracemalloc
import zlib
from collections.abc import Callable, Iterator

import httpx
import pytest

from gsynopsis.errors import ChangedError, SourceError, TransientError
from gsynopsis.stream.http import HttpSource

DATA = bytes(range(256)) * 40
ADDRESS = "https://files.example/a.gsyn"
Handler = Callable[[httpx.Request], httpx.Response]


def source_of(handler: Handler, **options: object) -> HttpSource:
    def sent(request: httpx.Request) -> httpx.Response:
        """As from a socket: a body is a stream, never a text that is there already."""
        answer = handler(request)
        if not answer.is_stream_consumed:
            return answer
        body = httpx.ByteStream(answer.content)
        return httpx.Response(answer.status_code, headers=answer.headers, stream=body)

    client = httpx.Client(transport=httpx.MockTransport(sent))
    return HttpSource(ADDRESS, client=client, **options)  # type: ignore[arg-type]


def span(request: httpx.Request) -> tuple[int, int] | None:
    match = re.fullmatch(r"bytes=(\d+)-(\d+)", request.headers.get("range", ""))
    return (int(match[1]), int(match[2]) + 1) if match else None


def honest(request: httpx.Request, data: bytes = DATA, tag: str = '"v1"') -> httpx.Response:
    wanted = span(request)
    current = request.headers.get("if-range", tag) == tag
    if wanted is None or not current:
        return httpx.Response(200, content=data, headers={"etag": tag})
    start, stop = wanted
    shown = f"bytes {start}-{stop - 1}/{len(data)}"
    headers = {"content-range": shown, "etag": tag}
    return httpx.Response(206, content=iter([data[start:stop]]), headers=headers)


def whole(request: httpx.Request) -> httpx.Response:
    return httpx.Response(200, content=DATA)


def gzip_on_range(request: httpx.Request) -> httpx.Response:
    answer = honest(request)
    if answer.status_code == 200:
        return answer
    body = iter([gzip.compress(answer.read())])
    headers = {"content-range": answer.headers["content-range"], "content-encoding": "gzip"}
    return httpx.Response(206, content=body, headers=headers)


def gzip_on_all(request: httpx.Request) -> httpx.Response:
    body, headers = iter([gzip.compress(DATA)]), {"content-encoding": "gzip"}
    return httpx.Response(200, content=body, headers=headers)


def wrong_content_range(request: httpx.Request) -> httpx.Response:
    answer = honest(request)
    if answer.status_code == 206:
        answer.headers["content-range"] = f"bytes 3-12/{len(DATA)}"
    return answer


def no_content_range(request: httpx.Request) -> httpx.Response:
    answer = honest(request)
    answer.headers.pop("content-range", None)
    return answer


@pytest.mark.parametrize(
    "handler", [honest, whole, gzip_on_range, gzip_on_all, wrong_content_range, no_content_range]
)
def test_whatever_the_server_does_the_bytes_are_right(handler: Handler) -> None:
    source = source_of(handler)
    for start, stop in [(10, 700), (0, 1), (9000, len(DATA)), (10, 700)]:
        assert b"".join(source.read(start, stop)) == DATA[start:stop]


def test_a_server_without_ranges_is_read_once() -> None:
    asked: list[httpx.Request] = []

    def handler(request: httpx.Request) -> httpx.Response:
        asked.append(request)
        return whole(request)

    source = source_of(handler)
    for start in (5000, 0, 100):
        assert b"".join(source.read(start, start + 9)) == DATA[start : start + 9]
    assert len(asked) == 1


@pytest.mark.parametrize("declared", [True, False])
def test_a_whole_file_over_the_cap_is_refused(declared: bool) -> None:
    def handler(request: httpx.Request) -> httpx.Response:
        body = DATA if declared else iter([DATA[:5000], DATA[5000:]])
        return httpx.Response(200, content=body)

    with pytest.raises(SourceError, match="without ranges"):
        list(source_of(handler, whole_max=6000).read(0, len(DATA)))


@pytest.mark.parametrize("handler", [honest, whole])
def test_a_range_ends_with_its_file(handler: Handler) -> None:
    def clipping(request: httpx.Request) -> httpx.Response:
        wanted = span(request)
        if wanted:
            request.headers["range"] = f"bytes={wanted[0]}-{min(wanted[1], len(DATA)) - 1}"
        return handler(request)

    assert b"".join(source_of(clipping).read(len(DATA) - 5, len(DATA) + 5)) == DATA[-5:]


def test_a_range_behind_a_whole_file_is_refused() -> None:
    with pytest.raises(SourceError, match="within 10240 bytes"):
        list(source_of(whole).read(len(DATA), len(DATA) + 5))


@pytest.mark.parametrize("status", [500, 502, 503, 429, 408])
def test_a_busy_server_is_worth_another_try(status: int) -> None:
    def handler(request: httpx.Request) -> httpx.Response:
        return httpx.Response(status, headers={"retry-after": "7"})

    with pytest.raises(TransientError, match=str(status)) as caught:
        list(source_of(handler).read(0, 9))
    assert caught.value.after == 7


@pytest.mark.parametrize("status", [403, 404, 410, 416, 204])
def test_a_refusal_is_final(status: int) -> None:
    with pytest.raises(SourceError, match=str(status)) as caught:
        list(source_of(lambda _: httpx.Response(status)).read(0, 9))
    assert not isinstance(caught.value, TransientError | ChangedError)


def test_a_body_that_stops_early_gives_what_came_and_then_a_transient_error() -> None:
    def body() -> Iterator[bytes]:
        yield DATA[:33]
        raise httpx.ReadError("connection lost")

    def handler(request: httpx.Request) -> httpx.Response:
        headers = {"content-range": f"bytes 0-99/{len(DATA)}"}
        return httpx.Response(206, content=body(), headers=headers)

    got = b""
    with pytest.raises(TransientError, match="connection lost"):
        for piece in source_of(handler).read(0, 100):
            got += piece
    assert got == DATA[:33]


@pytest.mark.parametrize(("sent", "error"), [(99, TransientError), (101, SourceError)])
def test_a_body_of_another_length_is_no_answer(sent: int, error: type[SourceError]) -> None:
    def handler(request: httpx.Request) -> httpx.Response:
        headers = {"content-range": f"bytes 0-99/{len(DATA)}"}
        return httpx.Response(206, content=iter([DATA[:sent]]), headers=headers)

    with pytest.raises(error):
        list(source_of(handler).read(0, 100))


@pytest.mark.parametrize("change", ["tag", "size", "shorter", "blind tag"])
def test_a_file_that_changed_between_requests_is_noticed(change: str) -> None:
    state = {"data": DATA, "tag": '"v1"'}

    def handler(request: httpx.Request) -> httpx.Response:
        if change == "blind tag":  # a host that ignores If-Range
            request.headers.pop("if-range", None)
        return honest(request, state["data"], state["tag"])  # type: ignore[arg-type]

    source = source_of(handler)
    assert b"".join(source.read(0, 50)) == DATA[:50]
    if "tag" in change:
        state["tag"] = '"v2"'
    else:
        state["data"] = DATA + b"x" if change == "size" else DATA[:40]
    with pytest.raises(ChangedError, match="another version"):
        list(source.read(50, 90))


def test_if_range_carries_a_strong_tag_only() -> None:
    seen: list[str | None] = []

    def handler(request: httpx.Request, tag: str) -> httpx.Response:
        seen.append(request.headers.get("if-range"))
        request.headers.pop("if-range", None)
        return honest(request, tag=tag)

    for tag in ('"strong"', 'W/"weak"'):
        source = source_of(lambda r, tag=tag: handler(r, tag))
        assert [b"".join(source.read(0, 9)) for _ in range(2)] == [DATA[:9]] * 2
    assert seen == [None, '"strong"', None, None]


def test_messages_hide_what_an_address_is_signed_with() -> None:
    seen: list[httpx.Request] = []

    def handler(request: httpx.Request) -> httpx.Response:
        seen.append(request)
        return honest(request) if len(seen) < 2 else httpx.Response(403)

    client = httpx.Client(transport=httpx.MockTransport(handler))
    source = HttpSource(f"{ADDRESS}?sig=1", client=client)
    assert b"".join(source.read(0, 9)) == DATA[:9]
    with pytest.raises(SourceError) as caught:
        list(source.read(0, 9))
    assert {r.url.params["sig"] for r in seen} == {"1"}
    assert {r.headers["accept-encoding"] for r in seen} == {"identity"}
    assert "sig" not in str(caught.value)


@pytest.mark.parametrize("coding", ["gzip, gzip", "br", "deflate", "zstd", "x" * 500])
def test_other_codings_than_one_gzip_are_refused_before_a_byte_is_read(coding: str) -> None:
    read: list[int] = []

    def body() -> Iterator[bytes]:
        read.append(1)
        yield gzip.compress(gzip.compress(DATA))

    def handler(request: httpx.Request) -> httpx.Response:
        return httpx.Response(200, content=body(), headers={"content-encoding": coding})

    with pytest.raises(SourceError, match="found Content-Encoding") as caught:
        list(source_of(handler).read(0, 9))
    assert not isinstance(caught.value, TransientError)
    assert len(str(caught.value)) < 300
    assert not read


def test_a_gzip_of_gigabytes_is_given_up_at_the_cap_in_little_memory() -> None:
    packer = zlib.compressobj(9, wbits=31)
    # 128 MiB of zeros in one piece of 128 KiB: what a library would inflate in one go.
    bomb = b"".join([packer.compress(bytes(1 << 20)) for _ in range(128)]) + packer.flush()

    def handler(request: httpx.Request) -> httpx.Response:
        return httpx.Response(200, content=iter([bomb]), headers={"content-encoding": "gzip"})

    tracemalloc.start()
    try:
        with pytest.raises(SourceError, match="without ranges"):
            list(source_of(handler, whole_max=1 << 20).read(0, 2 << 20))
        assert tracemalloc.get_traced_memory()[1] < 8 << 20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("cut", "error"), [(slice(0, 60), TransientError), (slice(11, None), SourceError)]
)
def test_a_gzip_that_is_damaged_or_ends_early_is_an_error(
    cut: slice, error: type[SourceError]
) -> None:
    def handler(request: httpx.Request) -> httpx.Response:
        body, headers = iter([gzip.compress(DATA)[cut]]), {"content-encoding": "gzip"}
        return httpx.Response(200, content=body, headers=headers)

    with pytest.raises(error):
        list(source_of(handler).read(0, len(DATA)))


def tls() -> Exception:
    error = httpx.ConnectError("certificate verify failed")
    error.__cause__ = ssl.SSLCertVerificationError("self-signed")
    return error


@pytest.mark.parametrize(
    "failure", [httpx.UnsupportedProtocol("ftp"), httpx.TooManyRedirects("9"), tls()]
)
def test_what_will_never_work_is_not_worth_another_try(failure: Exception) -> None:
    def handler(request: httpx.Request) -> httpx.Response:
        raise failure

    with pytest.raises(SourceError) as caught:
        list(source_of(handler).read(0, 9))
    assert not isinstance(caught.value, TransientError)


def test_the_length_is_known_with_the_first_answer_wherever_a_host_says_it() -> None:
    assert source_of(honest).size is None
    for handler in (honest, whole):
        source = source_of(handler)
        next(source.read(0, 9))
        assert source.size == len(DATA)


@pytest.mark.parametrize("address", ["ftp://a/b", "a.gsyn", "http://", "http://[::1"])
def test_what_is_no_http_address_is_refused(address: str) -> None:
    with pytest.raises(SourceError):
        HttpSource(address)
