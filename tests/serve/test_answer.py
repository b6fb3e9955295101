"""Ranges, conditions, versions: what a client is told about one file (RFC 9110 §13, §14)."""

import asyncio
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from starlette.datastructures import Headers

from gsynopsis.serve import answer as answers
from gsynopsis.serve.answer import PIECE, file_answer, precondition
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import Root, root_of
from gsynopsis.serve.run import serving

DATA = bytes(range(250)) * 4
LONG_AGO = 1_000_000_000


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    folder = tmp_path_factory.mktemp("answers")
    (folder / "a.gsyn").write_bytes(DATA)
    (folder / "empty.gsyn").write_bytes(b"")
    (folder / "young.gsyn").write_bytes(DATA)
    os.utime(folder / "a.gsyn", (LONG_AGO, LONG_AGO))
    os.utime(folder / "young.gsyn", (time.time() + 60, time.time() + 60))
    with serving(make_app(root_of(folder))) as address, httpx.Client(base_url=address) as client:
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
        ("bytes=0-99999999999999999999", 0, 999),
        ("bytes=3-4,5000-", 3, 4),
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
def test_what_is_no_range_gets_the_whole_file(client: httpx.Client, header: str) -> None:
    answer = ask(client, header)
    assert (answer.status_code, answer.content) == (200, DATA)
    assert answer.headers["accept-ranges"] == "bytes"


@pytest.mark.parametrize("header", ["bytes=1000-", "bytes=-0", "bytes=99999999999999999999-"])
def test_what_lies_outside_is_416_with_the_size(client: httpx.Client, header: str) -> None:
    answer = ask(client, header)
    assert answer.status_code == 416
    assert answer.headers["content-range"] == "bytes */1000"


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


def test_head_has_the_headers_of_the_whole_file_and_ignores_ranges(client: httpx.Client) -> None:
    answer = client.head("/a.gsyn", headers={"Range": "bytes=0-1"})
    assert (answer.status_code, answer.content) == (200, b"")
    assert answer.headers["content-length"] == "1000"
    assert answer.headers["content-type"] == "application/octet-stream"
    assert answer.headers["cache-control"] == "public, max-age=31536000"


def test_an_empty_file_is_200_and_has_no_range(client: httpx.Client) -> None:
    assert client.get("/empty.gsyn").content == b""
    answer = client.get("/empty.gsyn", headers={"Range": "bytes=0-"})
    assert (answer.status_code, answer.headers["content-range"]) == (416, "bytes */0")


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


def test_overlapping_ranges_send_no_byte_twice(client: httpx.Client) -> None:
    answer = ask(client, "bytes=0-,0-,-500")
    assert answer.headers["content-range"] == "bytes 0-999/1000"
    assert answer.content == DATA


def test_a_date_names_no_version_of_a_file_that_was_just_written(client: httpx.Client) -> None:
    date = client.head("/young.gsyn").headers["last-modified"]
    headers = {"Range": "bytes=0-1", "If-Range": date}
    assert client.get("/young.gsyn", headers=headers).status_code == 200


EARLY, LATE = "Mon, 01 Jan 2001 00:00:00 GMT", "Sun, 01 Jan 2023 00:00:00 GMT"


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"If-Match": '"other"'}, 412),
        ({"If-Match": '"other", "tag"'}, 0),
        ({"If-Match": "*"}, 0),
        ({"If-Match": 'W/"tag"'}, 412),
        ({"If-Match": '"tag"', "If-None-Match": '"tag"'}, 304),
        ({"If-Match": '"other"', "If-None-Match": '"tag"'}, 412),
        ({"If-Unmodified-Since": EARLY}, 412),
        ({"If-Unmodified-Since": LATE}, 0),
        ({"If-Unmodified-Since": "nonsense"}, 0),
        ({"If-Match": '"tag"', "If-Unmodified-Since": EARLY}, 0),
        ({"If-None-Match": 'W/"tag"'}, 304),
        ({"If-None-Match": '"other"', "If-Modified-Since": LATE}, 0),
        ({"If-Modified-Since": LATE}, 304),
        ({"If-Modified-Since": EARLY}, 0),
        ({}, 0),
    ],
)
def test_conditions_are_judged_in_the_order_of_the_standard(
    headers: dict[str, str], status: int
) -> None:
    assert precondition(Headers(headers), '"tag"', float(LONG_AGO)) == status
    if not any(name.endswith("Since") for name in headers):
        assert precondition(Headers(headers), '"tag"') == status


def test_a_client_that_expects_another_version_gets_412(client: httpx.Client) -> None:
    tag = client.head("/a.gsyn").headers["etag"]
    for wrong in ({"If-Match": '"x"'}, {"If-Unmodified-Since": "Mon, 01 Jan 2001 00:00:00 GMT"}):
        answer = client.get("/a.gsyn", headers={"Range": "bytes=0-1", **wrong})
        assert answer.status_code == 412 and answer.headers["etag"] == tag
    assert client.get("/a.gsyn", headers={"If-Match": tag}).content == DATA


def test_no_range_mixes_two_versions_while_a_file_is_replaced(tmp_path: Path) -> None:
    # Versions of one length, replaced as fast as it goes: only the open file tells them apart.
    size, path, draft = 3 * PIECE, tmp_path / "a.gsyn", tmp_path / "draft"
    path.write_bytes(bytes(size))
    ended = threading.Event()

    def replace() -> None:
        number = 0
        while not ended.is_set():
            number = (number + 1) % 256
            draft.write_bytes(bytes([number]) * size)
            os.replace(draft, path)

    writer = threading.Thread(target=replace)
    versions: dict[str, set[int]] = {}
    with serving(make_app(root_of(tmp_path))) as address, httpx.Client() as client:
        writer.start()
        try:
            for turn in range(300):
                # Within one piece and across several, and conditions on the version before.
                length = (100, PIECE + 1, size)[turn % 3]
                header = {"Range": f"bytes=0-{length - 1}"}
                answer = client.get(f"{address}/a.gsyn", headers=header)
                assert answer.status_code == 206 and len(answer.content) == length
                found = versions.setdefault(answer.headers["etag"], set())
                found |= set(answer.content)
        finally:
            ended.set()
            writer.join()
    assert len(versions) > 20
    assert all(len(values) == 1 for values in versions.values())


def descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="no /proc: leaks NOT checked")
def test_every_answer_gives_its_descriptor_back(tmp_path: Path) -> None:
    path = tmp_path / "a.gsyn"
    path.write_bytes(bytes(3 * PIECE))
    root = Root(tmp_path.resolve())

    async def answer(method: str, headers: dict[str, str], fails: bool) -> None:
        async def receive() -> dict[str, str]:
            await asyncio.sleep(60)
            return {"type": "http.disconnect"}

        async def send(message: object) -> None:
            if fails:
                raise ConnectionError

        file = root.open("a.gsyn")
        assert file is not None
        found = await file_answer(file, method, Headers(headers))
        await found({"type": "http", "method": method, "headers": []}, receive, send)

    kinds = [{}, {"range": "bytes=0-1"}, {"range": "bytes=0-1,9-9"}, {"range": "bytes=-0"}]
    kinds += [{"if-none-match": "*"}, {"if-match": '"x"'}, {"range": f"bytes=5-{2 * PIECE}"}]

    async def all_answers() -> None:
        for headers in kinds:
            for method in ("GET", "HEAD"):
                await answer(method, headers, fails=False)
                with pytest.raises((ConnectionError, ExceptionGroup)):
                    await answer(method, headers, fails=True)

    asyncio.run(all_answers())
    before = descriptors()
    asyncio.run(all_answers())
    assert descriptors() == before


@pytest.mark.parametrize("change", ["cut", "written"])
def test_an_answer_whose_file_changes_under_it_ends_and_is_not_padded(
    tmp_path: Path, change: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.gsyn"
    path.write_bytes(bytes(8 * PIECE))
    real = answers.OpenFile.read

    def read(file: answers.OpenFile, start: int, stop: int) -> bytes:
        if start == 4 * PIECE:
            with path.open("r+b") as writer:
                writer.truncate(4 * PIECE + 10) if change == "cut" else writer.write(b"x")
            os.utime(path, (LONG_AGO, LONG_AGO))
        return real(file, start, stop)

    monkeypatch.setattr(answers.OpenFile, "read", read)
    got = 0
    with (
        serving(make_app(root_of(path))) as address,
        pytest.raises(httpx.RemoteProtocolError, match="without sending complete message body"),
        httpx.stream("GET", f"{address}/a.gsyn") as answer,
    ):
        assert answer.headers["content-length"] == str(8 * PIECE)
        for piece in answer.iter_bytes():
            got += len(piece)
    assert got == 4 * PIECE
