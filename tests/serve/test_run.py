import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path

import httpx
import pytest

from gsynopsis.errors import InputError
from gsynopsis.serve import run
from gsynopsis.serve.answer import PIECE
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.gate import Gate, Limits
from gsynopsis.serve.run import listen, serving
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


def connect(address: str) -> socket.socket:
    host, _, port = address.removeprefix("http://").partition(":")
    return socket.create_connection((host, int(port)), timeout=5)


@pytest.fixture
def gates(monkeypatch: pytest.MonkeyPatch) -> list[Gate]:
    """The gates of the servers that are started."""
    kept: list[Gate] = []

    def kept_gate(limits: Limits) -> Gate:
        kept.append(Gate(limits))
        return kept[-1]

    monkeypatch.setattr(run, "Gate", kept_gate)
    return kept


def until(true: Callable[[], bool]) -> None:
    """Wait until it is true; the test's own limit is 20 s."""
    ended = time.monotonic() + 20
    while not true():
        assert time.monotonic() < ended
        time.sleep(0.01)


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


REQUEST = b"GET /a.gsyn HTTP/1.1\r\nHost: a\r\n\r\n"
SOON = Limits(head_seconds=0.4, idle_seconds=0.4, send_seconds=0.4, linger_seconds=0.4)


def ends(connection: socket.socket) -> bool:
    """The server closes the connection; whatever it still sends is read."""
    connection.settimeout(5)
    with suppress(ConnectionResetError):
        while connection.recv(1 << 20):
            pass
    return True


def drip(connection: socket.socket, text: bytes) -> bool:
    """Send it byte by byte, for some seconds at most; whether the server closed meanwhile."""
    connection.settimeout(0.05)
    for byte in text:
        try:
            connection.sendall(bytes([byte]))
            if not connection.recv(1 << 16):
                return True
        except TimeoutError:
            continue
        except OSError:
            return True
    return False


HEAD = b"GET /a.gsyn HTTP/1.1\r\nHost: a\r\nX-Long: " + b"x" * 100
KINDS: dict[str, tuple[bytes, bytes]] = {
    "says nothing": (b"", b""),
    "begins a head and stops": (b"GET /a.gsyn HTTP/1.1\r\nX: ", b""),
    "drips its first head": (b"", HEAD),
    "rests after an answer": (REQUEST, b""),
    "drips its second head": (REQUEST, HEAD),
    "drips a body of a gigabyte": (
        b"POST /a.gsyn HTTP/1.1\r\nHost: a\r\nContent-Length: 1000000000\r\n\r\n",
        b"x" * 100,
    ),
    "drips a body of chunks": (
        b"GET /a.gsyn HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: chunked\r\n\r\n",
        b"1\r\nx\r\n" * 20,
    ),
    "talks nonsense": (b"nonsense\r\n\r\n", b"x" * 100),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_client_that_keeps_us_waiting_is_let_go(scene: Path, kind: str) -> None:
    first, rest = KINDS[kind]
    with serving(make_app(root_of(scene)), limits=SOON) as address, connect(address) as client:
        client.sendall(first)
        assert drip(client, rest) or ends(client)
        assert httpx.head(f"{address}/a.gsyn").status_code == 200


@pytest.mark.parametrize("before", [b"", REQUEST], ids=["at the door", "after an answer"])
@pytest.mark.parametrize(
    ("text", "status"),
    [(KINDS["drips a body of a gigabyte"][0], b"405"), (KINDS["talks nonsense"][0], b"400")],
    ids=["a body", "nonsense"],
)
def test_a_refused_client_is_not_reset_while_it_reads_why(
    scene: Path, before: bytes, text: bytes, status: bytes, gates: list[Gate]
) -> None:
    limits = Limits(linger_seconds=0.6)
    with serving(make_app(root_of(scene)), limits=limits) as address, connect(address) as client:
        got = bytearray()
        if before:
            client.sendall(before)
            while len(got) < scene.stat().st_size:
                got += client.recv(1 << 20)
        client.sendall(text)
        got = bytearray(client.recv(1 << 16))
        assert got.startswith(b"HTTP/1.1 " + status)
        for name in (b"connection: close", b"x-content-type-options: nosniff", b"\r\ndate: "):
            assert name in got
        for _ in range(4):  # a reset would come after the first
            client.sendall(b"x" * 1000)
            time.sleep(0.05)
        assert gates[0].count == 1
        until(lambda: gates[0].count == 0)
        assert ends(client)


@pytest.mark.parametrize("size", [PIECE, 32 << 20], ids=["short", "long"])
def test_a_client_that_takes_nothing_is_let_go(
    tmp_path: Path, size: int, gates: list[Gate]
) -> None:
    path = tmp_path / "a.gsyn"
    path.write_bytes(bytes(size))
    limits = Limits(send_seconds=0.4)
    with serving(make_app(root_of(path)), limits=limits) as address:
        with connect(address) as slow:
            # Little room on the way, so that also a short answer is stuck.
            slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            asked = 1 if size > PIECE else 400
            slow.sendall(REQUEST * asked)
            until(lambda: gates[0].count == 1)
            until(lambda: gates[0].count == 0)
        assert httpx.head(f"{address}/a.gsyn").status_code == 200


def test_a_slow_client_that_takes_something_gets_everything(tmp_path: Path) -> None:
    path = tmp_path / "a.gsyn"
    data = bytes(range(256)) * (8 << 10)
    path.write_bytes(data)
    limits = Limits(head_seconds=0.3, idle_seconds=0.3, send_seconds=0.5)
    with serving(make_app(root_of(path)), limits=limits) as address:
        got = bytearray()
        with httpx.stream("GET", f"{address}/a.gsyn") as answer:
            for piece in answer.iter_bytes(64 << 10):
                got += piece
                time.sleep(0.05)  # 1.6 s in all, several times every limit
    assert bytes(got) == data


def test_the_one_that_keeps_us_waiting_longest_makes_room(scene: Path) -> None:
    limits = Limits(connections=40, share=1.0, spared_seconds=0)
    with serving(make_app(root_of(scene)), limits=limits) as address, ExitStack() as stack:
        silent = [stack.enter_context(connect(address)) for _ in range(80)]
        client = stack.enter_context(httpx.Client())
        for _ in range(5):
            assert client.get(f"{address}/a.gsyn").status_code == 200
        closed = [connection in select.select(silent, [], [], 0)[0] for connection in silent]
        assert closed == [True] * 41 + [False] * 39


def test_no_address_takes_all_connections(scene: Path, gates: list[Gate]) -> None:
    limits = Limits(connections=8, share=0.5, spared_seconds=0)
    with serving(make_app(root_of(scene)), limits=limits) as address:
        with ExitStack() as stack:
            for _ in range(20):
                stack.enter_context(connect(address))
            assert httpx.get(f"{address}/a.gsyn").status_code == 200
            assert gates[0].count <= 4
        until(lambda: gates[0].count == 0)


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


def test_connections_do_not_wait_to_fill_packets_and_leave_no_timer(
    scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Without TCP_NODELAY a body waits 40 ms for the receipt of its head; a timer of 15 s would keep
    # what belongs to a connection long after it is gone.
    nodelay: list[int] = []
    timers: list[object] = []
    lost = run.PatientProtocol.connection_lost

    class Watched(run.PatientProtocol):
        def connection_lost(self, exc: Exception | None) -> None:
            sock = self.transport.get_extra_info("socket")
            nodelay.append(sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
            timer = self.timeout_keep_alive_task
            lost(self, exc or ConnectionResetError())
            timers.append((timer is not None, self.timeout_keep_alive_task))

    monkeypatch.setattr(run, "PatientProtocol", Watched)
    with serving(make_app(root_of(scene))) as address:
        assert httpx.get(f"{address}/a.gsyn").status_code == 200
    assert nodelay == [1]
    assert timers == [(True, None)]


SERVER = """
import resource, sys
from pathlib import Path
resource.setrlimit(resource.RLIMIT_NOFILE, (128, 128))
from gsynopsis.cli import main
held = [open(sys.argv[1]) for _ in range(int(sys.argv[2]))]
sys.exit(main(["serve", sys.argv[1], "--port", "0"]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="sockets are no descriptors there")
@pytest.mark.parametrize("held", [0, 100], ids=["enough", "none left"])
@pytest.mark.usefixtures("interruptible")
def test_three_hundred_silent_clients_lock_nobody_out_and_fill_no_log(
    scene: Path, held: int
) -> None:
    # With 100 other files open there are fewer descriptors than the server counts on.
    line = [sys.executable, "-c", SERVER, str(scene), str(held)]
    with (
        subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child,
        ExitStack() as stack,
    ):
        assert child.stdout is not None and child.stderr is not None
        address = child.stdout.readline().split("/ ")[0]
        for _ in range(300):
            stack.enter_context(connect(address))
        good = tried = 0
        while good < 15 and tried < 30:
            tried += 1
            with suppress(httpx.TransportError):
                good += httpx.get(f"{address}/a.gsyn", timeout=10).status_code == 200
        child.send_signal(signal.SIGINT)
        said = child.stderr.read()
        assert child.wait(timeout=20) in {0, 130}
    assert good >= (15 if not held else 1), said
    assert len(said) < 20_000
