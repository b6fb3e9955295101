"""The server's socket, limits, link and log."""

import logging
import socket
import time
from pathlib import Path

import httpx
import pytest

from gsynopsis.errors import InputError
from gsynopsis.serve import run
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.run import LINE_MAX, is_local, listen, one_plain_line, plain, serving
from gsynopsis.serve.throttle import LinkCut
from gsynopsis.stream.fetch import Fetcher
from gsynopsis.stream.http import HttpSource
from gsynopsis.stream.trace import steady
from gsynopsis.stream.transport import ThreadTransport
from gsynopsis.stream.virtual import Link, random_cuts


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "a.gsyn"
    path.write_bytes(bytes(range(256)) * 4096)
    return path


def test_a_port_in_use_is_one_clear_error() -> None:
    with listen("127.0.0.1", 0) as first, pytest.raises(InputError, match="another --port"):
        listen("127.0.0.1", first.getsockname()[1])


@pytest.mark.parametrize(
    ("host", "port"),
    [("no.such.host.invalid", 0), ("127.0.0.1", 70000), (".5", 0), ("x" * 70, 0)],
)
def test_an_impossible_address_is_one_clear_error(host: str, port: int) -> None:
    with pytest.raises(InputError, match=host):
        listen(host, port)


def test_the_link_is_as_fast_as_it_says_and_breaks_where_it_says(scene: Path) -> None:
    data = scene.read_bytes()
    link = Link(steady(16), 0.02, random_cuts(len(data), 5, seed=2))
    with serving(make_app(root_of(scene), link=link)) as address:
        fetch = Fetcher(ThreadTransport(HttpSource(f"{address}/a.gsyn")), "a", seed=0)
        spans = {k: (k << 18, (k + 1) << 18) for k in range(4)}
        for key in (0, 1, 2):
            fetch.request(key, *spans[key])
        began, got = time.monotonic(), dict[object, bytes]()
        while fetch.keys:
            for item in fetch.wait(60.0):
                got[item.key] = item.data
            if fetch.free and 3 not in got and 3 not in fetch.keys:
                fetch.request(3, *spans[3])
        took = time.monotonic() - began
        fetch.close()
    assert got == {key: data[a:b] for key, (a, b) in spans.items()}
    assert fetch.retries == 5
    assert fetch.received <= len(data) * 1.01
    # 1 MiB at 2 MB/s takes 0.52 s; round trips and waits after breaks come on top.
    assert 0.5 < took < 5


def test_a_socket_says_that_it_is_tcp_and_who_can_reach_it() -> None:
    # asyncio sets TCP_NODELAY for such sockets alone.
    with listen("127.0.0.1", 0) as local, listen("0.0.0.0", 0) as public:
        assert local.proto == socket.IPPROTO_TCP
        assert is_local(local) and not is_local(public)


def test_a_scene_whose_file_is_cut_off_meanwhile_is_not_padded(scene: Path) -> None:
    path = scene.with_name("long.gsyn")
    path.write_bytes(bytes(64 << 20))
    with (
        serving(make_app(root_of(path))) as address,
        pytest.raises(httpx.RemoteProtocolError, match="without sending complete message body"),
        httpx.stream("GET", f"{address}/long.gsyn") as answer,
    ):
        with path.open("r+b") as writer:
            writer.truncate(1000)
        for _ in answer.iter_bytes():
            pass


def test_connections_beyond_the_limit_are_told_so(
    scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "CONNECTIONS", 2)
    with serving(make_app(root_of(scene))) as address:
        host, _, port = address.removeprefix("http://").partition(":")
        with socket.create_connection((host, int(port))):
            assert httpx.get(f"{address}/a.gsyn").status_code == 503
        ended = time.monotonic() + 20
        while httpx.get(f"{address}/a.gsyn").status_code != 200:
            assert time.monotonic() < ended
            time.sleep(0.01)


def record(text: str, error: BaseException | None = None) -> logging.LogRecord:
    info = (type(error), error, error.__traceback__) if error else None
    return logging.LogRecord("uvicorn.error", logging.ERROR, "", 0, text, None, info)


def test_control_characters_are_escaped_in_the_log() -> None:
    hostile = "a\nfake line\r\x1b[2J\x00\x7f\x9b\u202e\u2028\udcff é景"
    assert plain(hostile) == r"a\nfake line\r\x1b[2J\x00\x7f\x9b\u202e\u2028\udcff é景"
    assert len(plain("x" * 10_000)) == LINE_MAX


def test_an_error_is_one_line_and_a_meant_end_of_a_link_none() -> None:
    found = record("Exception in ASGI application\n", OSError(5, "bad\nname"))
    assert one_plain_line(found)
    text = logging.Formatter().format(found)
    assert len(text.splitlines()) == 1
    assert r"OSError: [Errno 5] bad\nname" in text
    assert not one_plain_line(record("x", LinkCut()))
