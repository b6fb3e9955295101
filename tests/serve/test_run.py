import socket
import time
from contextlib import suppress
from pathlib import Path

import httpx
import pytest

from gsynopsis.errors import InputError
from gsynopsis.serve import run
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.run import listen, serving
from gsynopsis.stream.fetch import Fetcher
from gsynopsis.stream.http import HttpSource
from gsynopsis.stream.lines import ThreadLines
from gsynopsis.stream.trace import steady
from gsynopsis.stream.virtual import Link, random_cuts


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "a.gsyn"
    path.write_bytes(bytes(range(256)) * 4096)
    return path


def connect(address: str) -> socket.socket:
    host, _, port = address.removeprefix("http://").partition(":")
    return socket.create_connection((host, int(port)), timeout=5)


def test_a_port_in_use_is_one_clear_error() -> None:
    with listen("127.0.0.1", 0) as first, pytest.raises(InputError, match="another --port"):
        listen("127.0.0.1", first.getsockname()[1])


@pytest.mark.parametrize(("host", "port"), [("no.such.host.invalid", 0), ("127.0.0.1", 70000)])
def test_an_impossible_address_is_one_clear_error(host: str, port: int) -> None:
    with pytest.raises(InputError, match=host):
        listen(host, port)


def test_a_client_that_takes_nothing_is_let_go(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "SEND_SECONDS", 0.3)
    path = tmp_path / "big.gsyn"
    path.write_bytes(bytes(32 << 20))
    with serving(make_app(root_of(path))) as address:
        with connect(address) as slow:
            slow.sendall(b"GET /big.gsyn HTTP/1.1\r\nHost: a\r\n\r\n")
            time.sleep(1.0)
            got = 0
            with suppress(ConnectionResetError):
                while piece := slow.recv(1 << 20):
                    got += len(piece)
        assert got < 32 << 20
        assert httpx.head(f"{address}/big.gsyn").status_code == 200


def test_a_connection_that_never_asks_is_closed(
    scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "HEAD_SECONDS", 0.2)
    with serving(make_app(root_of(scene))) as address, connect(address) as silent:
        silent.sendall(b"GET /a.gsyn HTTP/1.1\r\nX: ")
        assert silent.recv(100) == b""


def test_the_link_is_as_fast_as_it_says_and_breaks_where_it_says(scene: Path) -> None:
    data = scene.read_bytes()
    link = Link(steady(16), 0.02, random_cuts(len(data), 5, seed=2))
    with serving(make_app(root_of(scene), link=link)) as address:
        fetch = Fetcher(ThreadLines(HttpSource(f"{address}/a.gsyn")), "a", seed=0)
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


def test_connections_do_not_wait_to_fill_packets_and_leave_no_timer(
    scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Without TCP_NODELAY a body waits 40 ms for the receipt of its head; a timer of 15 s would keep
    # what belongs to a connection long after it is gone.
    nodelay: list[int] = []
    timers: list[bool] = []
    lost = run.PatientProtocol.connection_lost

    class Watched(run.PatientProtocol):
        def connection_lost(self, exc: Exception | None) -> None:
            sock = self.transport.get_extra_info("socket")
            nodelay.append(sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
            timer = self._first
            lost(self, exc)
            timers.append(timer is not None and timer.cancelled() and self._first is None)

    monkeypatch.setattr(run, "PatientProtocol", Watched)
    with serving(make_app(root_of(scene))) as address:
        assert httpx.get(f"{address}/a.gsyn").status_code == 200
    assert nodelay == [1]
    assert timers == [True]
