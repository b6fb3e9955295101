"""Which requests are answered at all, with which headers, and what stands at the root."""

import json
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path

import httpx
import pytest

from gsynopsis.errors import SettingError
from gsynopsis.serve.app import make_app
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


def test_a_page_of_another_origin_may_read_scenes_and_nothing_else(client: httpx.Client) -> None:
    origin = {"Origin": SHOWN}
    answer = client.get("/a.gsyn", headers={"Range": "bytes=0-1", **origin})
    assert answer.headers["access-control-allow-origin"] == "*"
    assert "Content-Range" in answer.headers["access-control-expose-headers"]
    asked = {"Access-Control-Request-Method": "GET", "Access-Control-Request-Headers": "range"}
    answer = client.options("/a.gsyn", headers={**asked, **origin})
    assert answer.status_code == 200
    assert "range" in answer.headers["access-control-allow-headers"].lower()
    for name in ("/", "/index.html", "/main.js", "/listing.json", "/none"):
        assert "access-control-allow-origin" not in client.get(name, headers=origin).headers
        answer = client.options(name, headers={**asked, **origin})
        assert answer.status_code == 405
        assert "access-control-allow-origin" not in answer.headers


@pytest.mark.parametrize("name", ["/a.gsyn", "/", "/listing.json", "/none", "/none.gsyn"])
@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "TRACE", "OPTIONS", "ODD"])
def test_nothing_can_be_written(client: httpx.Client, method: str, name: str) -> None:
    for content in (b"", b"x" * 1000):
        answer = client.request(method, name, content=content)
        # A preflight request and a body where none belongs are the two other cases.
        assert answer.status_code == (400 if content and method == "OPTIONS" else 405)


@pytest.mark.parametrize(
    "more", [{"Content-Length": "1000000000"}, {"Transfer-Encoding": "chunked"}]
)
@pytest.mark.parametrize(("method", "status"), [("GET", 400), ("HEAD", 400), ("POST", 405)])
def test_a_body_is_refused_before_it_comes(
    client: httpx.Client, method: str, status: int, more: dict[str, str]
) -> None:
    # httpx would send the body that it announces.
    connection = HTTPConnection(client.base_url.host, client.base_url.port or 80, timeout=5)
    connection.request(method, "/a.gsyn", headers=more, encode_chunked=True)
    answer = connection.getresponse()
    assert answer.status == status
    assert answer.getheader("connection") == "close"
    answer.read()
    assert connection.sock is None
    connection.close()


def test_every_answer_says_what_it_is_and_what_a_browser_may_do_with_it(
    client: httpx.Client,
) -> None:
    names = ["/", "/index.html", "/main.js", "/listing.json", "/a.gsyn", "/none", "/none.gsyn"]
    for name in names:
        for method in ("GET", "HEAD", "POST"):
            headers = client.request(method, name).headers
            assert headers["x-content-type-options"] == "nosniff"
            assert headers["referrer-policy"] == "no-referrer"
            assert headers["content-security-policy"].startswith("default-src 'none'")


def test_a_scene_has_its_headers_and_is_never_compressed(client: httpx.Client) -> None:
    for more in ({}, {"Range": "bytes=0-99"}):
        answer = client.get("/a.gsyn", headers={"Accept-Encoding": "gzip, br", **more})
        assert "content-encoding" not in answer.headers
        assert answer.headers["content-type"] == "application/octet-stream"


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
