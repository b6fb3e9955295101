"""Which requests are answered at all, with which headers, and what stands at the root."""

import json
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path

import httpx
import pytest

from gsynopsis.errors import SettingError
from gsynopsis.serve.app import SECURITY_HEADERS, make_app
from gsynopsis.serve.files import Root, root_of
from gsynopsis.serve.run import serving

DATA = bytes(1000)
PAGE = '<title>v</title><!-- data --><script src="main.js"></script><script>go()</script>'
SHOWN = "https://elsewhere.example"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("app")
    (folder / "deep").mkdir()
    for name in ("a.gsyn", "deep/b.gsyn"):
        (folder / name).write_bytes(DATA)
    return folder


@pytest.fixture(scope="module")
def viewer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("viewer")
    (folder / "index.html").write_text(PAGE)
    (folder / "main.js").write_text("1 + 1; " * 500)
    return folder


@pytest.fixture(scope="module")
def client(folder: Path, viewer: Path) -> Iterator[httpx.Client]:
    app = make_app(root_of(folder), viewer=viewer)
    with serving(app) as address, httpx.Client(base_url=address) as client:
        yield client


def test_a_refused_body_ends_the_connection(client: httpx.Client) -> None:
    for method, status in (("POST", 405), ("GET", 400)):
        connection = HTTPConnection(client.base_url.host, client.base_url.port or 80, timeout=5)
        connection.request(method, "/a.gsyn", headers={"Content-Length": "1000000000"})
        answer = connection.getresponse()
        assert (answer.status, answer.getheader("connection")) == (status, "close")
        answer.read()
        assert connection.sock is None


def test_the_list_has_the_headers_of_everything_else(client: httpx.Client) -> None:
    headers = client.get("/listing.json").headers
    assert headers.items() >= SECURITY_HEADERS.items()


def test_the_list_names_what_can_be_streamed(client: httpx.Client) -> None:
    files = client.get("/listing.json").json()["files"]
    assert [f["name"] for f in files] == ["a.gsyn", "deep/b.gsyn"]
    assert files[0]["bytes"] == 1000
    assert client.get(files[1]["url"]).content == DATA
    assert files[0]["etag"] == client.head("/a.gsyn").headers["etag"]


def test_a_folder_of_scenes_has_a_gallery_whose_links_lead_to_the_viewer(
    client: httpx.Client,
) -> None:
    page = client.get("/")
    assert page.headers["content-type"].startswith("text/html")
    assert 'href="?content=deep/b.gsyn"' in page.text
    assert (
        "<script" not in page.text and "script-src" not in page.headers["content-security-policy"]
    )
    shown = client.get("/?content=deep/b.gsyn")
    assert "<script>go()</script>" in shown.text and "data-source" not in shown.text
    assert client.get("/index.html").text == shown.text


def test_a_single_scene_is_shown_at_once(folder: Path, viewer: Path) -> None:
    with serving(make_app(root_of(folder / "a.gsyn"), viewer=viewer)) as address:
        page = httpx.get(address)
        assert 'data-source="a.gsyn"></script>' in page.text
        assert "<!-- data -->" in httpx.get(f"{address}/?content=x").text


def test_a_single_scene_that_is_still_to_come_has_the_viewers_page(
    tmp_path: Path, viewer: Path
) -> None:
    with serving(make_app(Root(tmp_path.resolve(), "live.gsyn"), viewer=viewer)) as address:
        assert "<script>go()</script>" in httpx.get(address).text


def test_without_scenes_the_page_says_so(tmp_path: Path, viewer: Path) -> None:
    with serving(make_app(root_of(tmp_path), viewer=viewer)) as address:
        assert "no .gsyn file here" in httpx.get(address).text
        assert httpx.get(f"{address}/listing.json").json() == {"files": []}


def test_without_a_viewer_the_gallery_links_to_the_files(folder: Path) -> None:
    with serving(make_app(root_of(folder))) as address:
        assert 'href="deep/b.gsyn"' in httpx.get(f"{address}/?content=a.gsyn").text


def test_other_pages_may_frame_ours_only_where_they_are_named(folder: Path, viewer: Path) -> None:
    for embed, frames in (((), "'self'"), ((SHOWN,), f"'self' {SHOWN}"), (("*",), "'self' *")):
        app = make_app(root_of(folder), viewer=viewer, embed=embed)
        with serving(app) as address:
            for name in ("", "?content=a.gsyn"):
                policy = httpx.get(f"{address}/{name}").headers["content-security-policy"]
                assert policy.endswith(f"frame-ancestors {frames}")


@pytest.mark.parametrize("origin", ["elsewhere", "https://a.b; script-src *", "https://a\r\nx: y"])
def test_what_is_no_origin_does_not_get_into_a_header(
    folder: Path, viewer: Path, origin: str
) -> None:
    with pytest.raises(SettingError, match="--embed"):
        make_app(root_of(folder), viewer=viewer, embed=[origin])


def test_a_header_that_names_another_host_changes_no_address(client: httpx.Client) -> None:
    answer = client.get("/listing.json", headers={"Host": "evil.example"})
    assert "evil" not in json.dumps(answer.json())
