"""nginx with our configuration, as far as it differs from our server."""

import re
import shutil
import socket
import time
from contextlib import ExitStack
from pathlib import Path

import httpx
import pytest

from benchmarks.robust.nginx import CONFIGURATION, configured, nginx
from gsynopsis.serve.assets import read_site
from gsynopsis.serve.page import FOLDER
from tests.serve.servers import WITH_NGINX

WHOLE = b"GET /large.gsyn HTTP/1.1\r\nHost: a\r\n\r\n"


def test_the_policy_of_the_page_is_that_of_our_server() -> None:
    page = read_site(FOLDER).page()
    assert page is not None
    assert f'/index\\.html\\z" "{page.policy}";' in CONFIGURATION.read_text()


def test_a_configuration_without_the_expected_lines_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="0 lines `listen"):
        configured("server {}", tmp_path, 1)


@WITH_NGINX
def test_the_built_viewer_is_public_as_a_whole_and_at_the_root(tmp_path: Path) -> None:
    shutil.copytree(FOLDER, tmp_path, dirs_exist_ok=True)
    with nginx(tmp_path) as server, httpx.Client(base_url=server.address) as client:
        for path in FOLDER.iterdir():
            assert client.get(f"/{path.name}").content == path.read_bytes()
        assert client.get("/?content=a.gsyn").content == (FOLDER / "index.html").read_bytes()


@WITH_NGINX
def test_a_link_is_not_followed_even_to_a_scene(tmp_path: Path) -> None:
    (tmp_path / "a.gsyn").write_bytes(b"scene")
    (tmp_path / "in.gsyn").symlink_to(tmp_path / "a.gsyn")
    with nginx(tmp_path) as server:
        assert httpx.get(f"{server.address}/in.gsyn").status_code == 404


@WITH_NGINX
def test_one_address_takes_so_many_requests_and_others_are_still_answered(tmp_path: Path) -> None:
    (tmp_path / "large.gsyn").write_bytes(bytes(64 << 20))
    with nginx(tmp_path) as server, ExitStack() as stack:
        for _ in range(60):
            client = socket.create_connection(("127.0.0.1", server.port), 5, ("127.0.0.2", 0))
            stack.enter_context(client).sendall(WHOLE)
            client.recv(15)
        limit = re.search(r"limit_conn gsynopsis_address (\d+);", CONFIGURATION.read_text())
        assert limit is not None and int(limit[1]) < 60
        near = httpx.HTTPTransport(local_address="127.0.0.2")
        with httpx.Client(transport=near) as refused:
            answer = refused.head(f"{server.address}/large.gsyn")
            assert (answer.status_code, answer.headers["retry-after"]) == (503, "1")
        assert httpx.head(f"{server.address}/large.gsyn").status_code == 200


@WITH_NGINX
def test_a_line_of_the_log_cannot_be_forged(tmp_path: Path) -> None:
    request = 'GET /%0aforged.gsyn HTTP/1.1\r\nHost: a\r\nUser-Agent: \x1b[2J"\x7f\r\n\r\n'
    with nginx(tmp_path) as server:
        with socket.create_connection(("127.0.0.1", server.port), 5) as client:
            client.sendall(request.encode())
            assert client.recv(12) == b"HTTP/1.1 404"
        ended = time.monotonic() + 5
        while not (text := server.requests.read_text()) and time.monotonic() < ended:
            time.sleep(0.01)
    assert len(text.splitlines()) == 1 and text.rstrip("\n").isprintable()
    assert text.count('"') == 6, "quotes are escaped"
