"""Ranges and conditions, as our server and nginx answer them (RFC 9110 §13, §14)."""

import os
import threading
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from tests.serve.servers import SERVERS, client_of

DATA = bytes(range(250)) * 4
LONG_AGO = 1_000_000_000


@pytest.fixture(scope="module", params=SERVERS)
def client(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[httpx.Client]:
    folder = tmp_path_factory.mktemp("ranges")
    (folder / "a.gsyn").write_bytes(DATA)
    (folder / "empty.gsyn").write_bytes(b"")
    os.utime(folder / "a.gsyn", (LONG_AGO, LONG_AGO))
    with client_of(request.param, folder) as client:
        yield client


def ask(client: httpx.Client, header: str, **more: str) -> httpx.Response:
    headers = {"Range": header, **{k.replace("_", "-"): v for k, v in more.items()}}
    return client.get("/a.gsyn", headers=headers)


@pytest.mark.parametrize(
    ("header", "first", "last"),
    [
        ("bytes=0-0", 0, 0),
        ("bytes=10-19", 10, 19),
        ("bytes=990-", 990, 999),
        ("bytes=-10", 990, 999),
        ("bytes=-5000", 0, 999),
        ("bytes=0-999999999999999", 0, 999),
    ],
)
def test_a_range_is_206_with_its_bytes(
    client: httpx.Client, header: str, first: int, last: int
) -> None:
    answer = ask(client, header)
    assert answer.status_code == 206
    assert answer.headers["content-range"] == f"bytes {first}-{last}/1000"
    assert answer.headers["content-length"] == str(last + 1 - first)
    assert answer.content == DATA[first : last + 1]


@pytest.mark.parametrize("header", ["bytes=5-2", "bytes=x", "items=0-5", "bytes=", "nonsense"])
def test_what_is_no_range_gets_the_whole_file_or_an_error(
    client: httpx.Client, header: str
) -> None:
    # RFC 9110 §14.2 leaves it to the server: ours says 400, nginx 416 or 200.
    answer = ask(client, header)
    assert answer.status_code in {200, 400, 416}
    assert (answer.content == DATA) == (answer.status_code == 200)


@pytest.mark.parametrize("header", ["bytes=1000-", "bytes=-0", "bytes=99999999999999999999-"])
def test_what_lies_outside_is_416_with_the_size(client: httpx.Client, header: str) -> None:
    answer = ask(client, header)
    assert answer.status_code == 416
    assert answer.headers["content-range"] == "bytes */1000"
    assert ask(client, header, Origin="a").headers["access-control-allow-origin"] == "*"


def test_several_ranges_are_multipart(client: httpx.Client) -> None:
    answer = ask(client, "bytes=0-1,500-502")
    assert answer.status_code == 206
    assert answer.headers["content-type"].startswith("multipart/byteranges; boundary=")
    assert len(answer.content) == int(answer.headers["content-length"])
    for part in (b"bytes 0-1/1000", b"bytes 500-502/1000", DATA[:2], DATA[500:503]):
        assert part in answer.content


def test_if_range_gives_the_range_of_this_version_only(client: httpx.Client) -> None:
    head = client.head("/a.gsyn")
    tag, date = head.headers["etag"], head.headers["last-modified"]
    assert ask(client, "bytes=0-1", If_Range=tag).status_code == 206
    assert ask(client, "bytes=0-1", If_Range=date).status_code == 206
    for other in ('"other"', f"W/{tag}", "Mon, 01 Jan 2001 00:00:00 GMT"):
        answer = ask(client, "bytes=0-1", If_Range=other)
        assert (answer.status_code, answer.content) == (200, DATA)
    assert ask(client, "bytes=5000-", If_Range='"other"').status_code == 200


def test_head_has_the_headers_of_the_whole_file(client: httpx.Client) -> None:
    answer = client.head("/a.gsyn")
    assert (answer.status_code, answer.content) == (200, b"")
    assert answer.headers["content-length"] == "1000"
    assert answer.headers["accept-ranges"] == "bytes"
    assert answer.headers["content-type"] == "application/octet-stream"
    assert answer.headers["cache-control"] == "public, max-age=31536000"
    assert answer.headers["etag"].startswith('"')
    assert client.head("/a.gsyn", headers={"Range": "bytes=0-1"}).content == b""


def test_an_empty_file_is_200_and_has_no_range(client: httpx.Client) -> None:
    assert client.get("/empty.gsyn").content == b""
    answer = client.get("/empty.gsyn", headers={"Range": "bytes=0-"})
    # nginx ignores the range, as RFC 9110 §14.2 allows.
    found = answer.status_code, answer.headers.get("content-range")
    assert found in {(416, "bytes */0"), (200, None)}
    assert answer.status_code == 416 or answer.content == b""


def test_a_client_that_has_this_version_gets_304(client: httpx.Client) -> None:
    head = client.head("/a.gsyn").headers
    for known in (
        {"If-None-Match": f'"x", {head["etag"]}'},
        {"If-None-Match": "*"},
        {"If-Modified-Since": head["last-modified"]},
    ):
        answer = client.get("/a.gsyn", headers=known)
        assert (answer.status_code, answer.content) == (304, b"")
        assert answer.headers["etag"] == head["etag"]
    for old in ({"If-None-Match": '"x"'}, {"If-Modified-Since": "nonsense"}):
        assert client.get("/a.gsyn", headers=old).status_code == 200


def test_nothing_is_compressed(client: httpx.Client) -> None:
    for header in ({}, {"Range": "bytes=0-99"}):
        answer = client.get("/a.gsyn", headers={"Accept-Encoding": "gzip, br", **header})
        assert "content-encoding" not in answer.headers
        assert answer.headers["content-type"] == "application/octet-stream"


def test_overlapping_ranges_send_no_byte_twice(client: httpx.Client) -> None:
    answer = ask(client, "bytes=0-,0-,-500")
    assert answer.status_code in {200, 206} and answer.content == DATA


@pytest.mark.parametrize("kind", SERVERS)
def test_no_body_mixes_two_versions_while_a_file_is_replaced(kind: str, tmp_path: Path) -> None:
    # Versions of one length, replaced as fast as it goes: only the open file tells them apart.
    size, path, draft = 3 << 16, tmp_path / "a.gsyn", tmp_path / "draft"
    path.write_bytes(bytes(size))
    ended = threading.Event()

    def replace() -> None:
        number = 0
        while not ended.is_set():
            number = (number + 1) % 256
            draft.write_bytes(bytes([number]) * size)
            os.replace(draft, path)

    writer = threading.Thread(target=replace)
    seen: set[int] = set()
    with client_of(kind, tmp_path) as client:
        writer.start()
        try:
            for turn in range(150):
                length = (100, (1 << 16) + 1, size)[turn % 3]
                answer = client.get("/a.gsyn", headers={"Range": f"bytes=0-{length - 1}"})
                assert answer.status_code == 206 and len(answer.content) == length
                assert len(set(answer.content)) == 1
                seen |= set(answer.content)
        finally:
            ended.set()
            writer.join()
    assert len(seen) > 5
