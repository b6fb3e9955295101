"""What is public, how it may be asked for and by whom: our server and nginx alike."""

import os
import re
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path
from urllib.parse import quote

import httpx
import pytest

from gsynopsis.serve.files import address_of
from tests.serve.servers import SERVERS, client_of

DATA = bytes(range(250)) * 4
PAGE = {
    "index.html": '<title>v</title><script type="module" src="gsynopsis-main.js"></script>',
    "gsynopsis-main.js": "1 + 1; " * 500,
}
OTHERS = (
    "checkpoint.safetensors",
    "run.json",
    "report.html",
    "x<&.html",
    "photo.jpg",
    "listing.js",
)
ODD = (
    b"a#b?c%20d.gsyn",
    b"\xff\xfe.gsyn",
    b"100%.gsyn",
    b"new\nline\x1b[31m.gsyn",
    b"<b>&amp;'\".gsyn",
    "größe – 景.gsyn".encode(),
    b"a:b c+d;e.gsyn",
    b"back\\slash.gsyn",
)
"""Names as the file system has them; each holds its own name."""
REFUSED = {"serve": {404}, "nginx": {400, 404}}
SHOWN = "https://elsewhere.example"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    base = tmp_path_factory.mktemp("privacy")
    root, page = base / "root", base / "page"
    (root / "deep").mkdir(parents=True)
    page.mkdir()
    for place in (root, page):
        for name, text in PAGE.items():
            (place / name).write_text(text)
    (root / "a.gsyn").write_bytes(DATA)
    (root / "deep" / "b.gsyn").write_bytes(DATA[:10])
    (root / ".hidden.gsyn").write_bytes(b"secret")
    (root / ".store" / "deep").mkdir(parents=True)
    (root / ".store" / "deep" / "d.gsyn").write_bytes(b"secret")
    for name in OTHERS:
        (root / name).write_bytes(b"secret")
        (root / f"{name}.gsyn").symlink_to(root / name)
    for name in ODD:
        (root / os.fsdecode(name)).write_bytes(name)
    (base / "secret.gsyn").write_bytes(b"secret")
    (root / "out.gsyn").symlink_to(base / "secret.gsyn")
    (root / "up").symlink_to(base)
    (root / "loop").symlink_to(root / "loop")
    (root / "around.gsyn").symlink_to(root / "around.gsyn")
    (root / "hidden.gsyn").symlink_to(root / ".hidden.gsyn")
    (root / "stored.gsyn").symlink_to(root / ".store" / "deep" / "d.gsyn")
    (root / "store").symlink_to(root / ".store")
    (root / "folder.gsyn").mkdir()
    os.mkfifo(root / "pipe.gsyn")
    return base


@pytest.fixture(scope="module", params=SERVERS)
def kind(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def client(kind: str, folder: Path) -> Iterator[httpx.Client]:
    with client_of(kind, folder / "root", folder / "page") as client:
        yield client


def connected(client: httpx.Client) -> HTTPConnection:
    """A connection that sends what it is told: httpx tidies up, a hostile client does not."""
    return HTTPConnection(client.base_url.host, client.base_url.port or 80, timeout=5)


@pytest.mark.parametrize(
    "name",
    [
        "/../secret.gsyn",
        "/%2e%2e/secret.gsyn",
        "/deep/../../secret.gsyn",
        "/deep/..%2f..%2fsecret.gsyn",
        "//secret.gsyn",
        "/out.gsyn",
        "/up/secret.gsyn",
        "/loop",
        "/.hidden.gsyn",
        "/a.gsyn%00.html",
        "/deep",
        "/deep/",
        "/a.gsyn/",
        "/etc/passwd",
        "//etc/passwd",
        "/" + "a" * 5000,
        "/..\\secret.gsyn",
        "/hidden.gsyn",
        "/stored.gsyn",
        "/store/deep/d.gsyn",
        "/.store/deep/d.gsyn",
        "/%2estore/deep/d.gsyn",
        "/deep/%2e./out.gsyn",
        "/./a.gsyn",
        "/deep/./b.gsyn",
        "/a.gsyn%2f",
        "/%2fa.gsyn",
        "/%252e%252e/secret.gsyn",
        "/around.gsyn",
        "/folder.gsyn",
        "/pipe.gsyn",
        "/%ff%fe%fd.gsyn",
        "/a.gsyn%00",
        "/a.gsyn%0a",
        "/a.GSYN",
        "http://127.0.0.1/../secret.gsyn",
        *(f"/{quote(name)}" for name in OTHERS),
        *(f"/{quote(name)}.gsyn" for name in OTHERS),
    ],
)
def test_nothing_but_scenes_and_the_page_is_served(
    client: httpx.Client, kind: str, name: str
) -> None:
    connection = connected(client)
    connection.request("GET", name)
    answer = connection.getresponse()
    assert answer.status in REFUSED[kind]
    assert b"secret" not in answer.read()
    connection.close()


def test_every_scene_can_be_asked_for_whatever_its_name(client: httpx.Client) -> None:
    assert client.get("/a.gsyn").content == DATA
    assert client.get("/deep/b.gsyn").content == DATA[:10]
    for name in ODD:
        assert client.get(f"/{address_of(os.fsdecode(name))}").content == name


def test_the_page_and_its_scripts_are_served_compressed_and_asked_for_each_time(
    client: httpx.Client,
) -> None:
    for name, text in PAGE.items():
        answer = client.get(f"/{name}", headers={"Accept-Encoding": "gzip"})
        # Our server names the script by its bytes within the page.
        assert re.sub(r"v-[0-9a-f]{16}/", "", answer.text) == text
        assert answer.headers["content-type"].endswith("charset=utf-8")
        assert answer.headers["cache-control"] == "no-cache"
        same = {"If-None-Match": answer.headers["etag"], "Accept-Encoding": "gzip"}
        again = client.get(f"/{name}", headers=same)
        assert (again.status_code, again.content) == (304, b"")
        # A browser takes the headers of a 304 for those of the page that it has kept.
        policy = "content-security-policy"
        assert again.headers[policy] == answer.headers[policy]
    script = client.get("/gsynopsis-main.js", headers={"Accept-Encoding": "gzip"})
    assert script.headers["content-encoding"] == "gzip" and "accept-encoding" in (
        script.headers["vary"].lower()
    )


def test_a_page_of_another_origin_may_read_scenes_and_nothing_else(client: httpx.Client) -> None:
    origin = {"Origin": SHOWN}
    answer = client.get("/a.gsyn", headers={"Range": "bytes=0-1", **origin})
    assert answer.headers["access-control-allow-origin"] == "*"
    assert "Content-Range" in answer.headers["access-control-expose-headers"]
    asked = {"Access-Control-Request-Method": "GET", "Access-Control-Request-Headers": "range"}
    answer = client.options("/a.gsyn", headers={**asked, **origin})
    assert answer.is_success and answer.headers["access-control-allow-origin"] == "*"
    assert "range" in answer.headers["access-control-allow-headers"].lower()
    for name in ("/", "/index.html", "/gsynopsis-main.js", "/listing.json", "/none"):
        assert "access-control-allow-origin" not in client.get(name, headers=origin).headers
        answer = client.options(name, headers={**asked, **origin})
        assert answer.status_code == 405
        assert "access-control-allow-origin" not in answer.headers


@pytest.mark.parametrize("name", ["/a.gsyn", "/", "/listing.json", "/none", "/none.gsyn"])
@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "TRACE", "OPTIONS", "ODD"])
def test_nothing_can_be_written(client: httpx.Client, method: str, name: str) -> None:
    for content in (b"", b"x" * 1000):
        answer = client.request(method, name, content=content)
        assert answer.status_code == 405
        assert answer.headers["allow"] == "GET, HEAD"


@pytest.mark.parametrize(
    "more", [{"Content-Length": "1000000000"}, {"Transfer-Encoding": "chunked"}]
)
@pytest.mark.parametrize(("method", "status"), [("GET", 400), ("HEAD", 400), ("POST", 405)])
def test_a_body_is_refused_before_it_comes(
    client: httpx.Client, method: str, status: int, more: dict[str, str]
) -> None:
    connection = connected(client)
    connection.request(method, "/a.gsyn", headers=more, encode_chunked=True)
    answer = connection.getresponse()
    assert answer.status == status
    answer.read()
    connection.close()


def test_every_answer_says_what_it_is_and_what_a_browser_may_do_with_it(
    client: httpx.Client,
) -> None:
    names = ["/", "/index.html", "/gsynopsis-main.js", "/a.gsyn", "/none", "/none.gsyn"]
    for name in names:
        for method, more in (
            ("GET", {}),
            ("HEAD", {}),
            ("POST", {}),
            ("GET", {"Range": "bytes=9999-"}),
        ):
            headers = client.request(method, name, headers=more).headers
            assert headers["x-content-type-options"] == "nosniff"
            assert headers["referrer-policy"] == "no-referrer"
            assert headers["content-security-policy"].startswith("default-src 'none'")
