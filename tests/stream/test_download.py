"""A file of a web server comes whole, by the proxy that the environment names, or not at all."""

import threading
from collections.abc import Generator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from gsynopsis.errors import InputError, SourceError
from gsynopsis.stream.download import downloaded, name_of

pytest.importorskip("httpx")
BODY = bytes(range(256)) * 8


class _Recorder(BaseHTTPRequestHandler):
    """Answers everything with `BODY`, and keeps what was asked for."""

    def do_GET(self) -> None:
        self.server.asked.append(self.path)  # type: ignore[attr-defined]
        self.send_response(200)
        self.send_header("Content-Length", str(len(BODY)))
        self.end_headers()
        self.wfile.write(BODY)

    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Generator[ThreadingHTTPServer]:
    for name in ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY", "NO_PROXY"):
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.lower(), raising=False)
    with ThreadingHTTPServer(("127.0.0.1", 0), _Recorder) as server:
        server.asked = []  # type: ignore[attr-defined]
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server
        server.shutdown()


def quiet(done: int, total: int) -> None:
    pass


def test_a_proxy_of_the_environment_is_asked(
    server: ThreadingHTTPServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HTTP_PROXY", f"http://127.0.0.1:{server.server_port}")
    address = "http://splats.invalid/a/scene.ply?key=1"
    path = downloaded(address, tmp_path, quiet)
    assert path == tmp_path / "scene.ply" and path.read_bytes() == BODY
    assert server.asked == [address]  # type: ignore[attr-defined]


def test_a_file_over_the_limit_is_refused_and_leaves_nothing(
    server: ThreadingHTTPServer, tmp_path: Path
) -> None:
    address = f"http://127.0.0.1:{server.server_port}/scene.ply"
    with pytest.raises(SourceError, match="at most 100"):
        downloaded(address, tmp_path, quiet, most=100)
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("address", ["https://a.invalid/", "https://a.invalid/lod-meta.json"])
def test_an_address_without_a_file_of_splats_is_refused(address: str) -> None:
    with pytest.raises(InputError, match="expected"):
        name_of(address)
