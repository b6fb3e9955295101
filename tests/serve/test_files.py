from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from gsynopsis.errors import InputError
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.run import serving

DATA = bytes(range(250)) * 4


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    base = tmp_path_factory.mktemp("serve")
    root = base / "root"
    (root / "deep").mkdir(parents=True)
    (root / "a.gsyn").write_bytes(DATA)
    (root / "deep" / "b.gsyn").write_bytes(DATA[:10])
    (root / "empty.gsyn").write_bytes(b"")
    (root / "x<&.html").write_text("<p>hello")
    (root / ".hidden.gsyn").write_bytes(b"no")
    (base / "secret.gsyn").write_bytes(b"secret")
    (root / "out.gsyn").symlink_to(base / "secret.gsyn")
    (root / "up").symlink_to(base)
    (root / "in.gsyn").symlink_to(root / "a.gsyn")
    (root / "loop").symlink_to(root / "loop")
    return root


@pytest.fixture(scope="module")
def client(folder: Path) -> Iterator[httpx.Client]:
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


def test_a_page_of_another_origin_may_read_ranges(client: httpx.Client) -> None:
    answer = ask(client, "bytes=0-1", Origin="https://elsewhere.example")
    assert answer.headers["access-control-allow-origin"] == "*"
    assert "Content-Range" in answer.headers["access-control-expose-headers"]
    asked = {
        "Origin": "https://elsewhere.example",
        "Access-Control-Request-Method": "GET",
        "Access-Control-Request-Headers": "range",
    }
    answer = client.options("/a.gsyn", headers=asked)
    assert answer.status_code == 200
    assert "range" in answer.headers["access-control-allow-headers"].lower()


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
    ],
)
def test_nothing_outside_the_root_is_served(client: httpx.Client, name: str) -> None:
    # httpx tidies up paths; a hostile client does not.
    request = client.build_request("GET", "/")
    request.url = request.url.copy_with(raw_path=name.encode())
    answer = client.send(request)
    assert answer.status_code == 404
    assert b"secret" not in answer.content


def test_links_within_the_root_and_subfolders_are_served(client: httpx.Client) -> None:
    assert client.get("/in.gsyn").content == DATA
    assert client.get("/deep/b.gsyn").content == DATA[:10]


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE"])
def test_nothing_can_be_written(client: httpx.Client, method: str) -> None:
    assert client.request(method, "/a.gsyn").status_code == 405


def test_the_listing_names_what_can_be_streamed(client: httpx.Client) -> None:
    files = client.get("/listing.json").json()["files"]
    assert [f["name"] for f in files] == ["a.gsyn", "deep/b.gsyn", "empty.gsyn", "in.gsyn"]
    assert files[0]["bytes"] == 1000
    assert client.get(files[1]["url"]).content == DATA[:10]
    assert files[0]["etag"] == client.head("/a.gsyn").headers["etag"]
    page = client.get("/")
    assert page.headers["content-type"].startswith("text/html")
    assert "deep/b.gsyn" in page.text


def test_a_changed_file_has_another_tag(folder: Path, client: httpx.Client) -> None:
    path = folder / "c.bin"
    path.write_bytes(b"one")
    before = client.head("/c.bin").headers["etag"]
    path.write_bytes(b"two")
    assert client.head("/c.bin").headers["etag"] != before
    path.unlink()


def test_one_file_is_served_alone(folder: Path) -> None:
    with serving(make_app(root_of(folder / "a.gsyn"))) as address:
        assert httpx.get(f"{address}/a.gsyn").content == DATA
        assert httpx.get(f"{address}/empty.gsyn").status_code == 404
        assert len(httpx.get(f"{address}/listing.json").json()["files"]) == 1


def test_the_viewer_stands_at_the_root(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "index.html").write_text("viewer")
    (tmp_path / "main.js").write_text("1")
    with serving(make_app(root_of(folder), viewer=tmp_path)) as address:
        assert httpx.get(address).text == "viewer"
        script = httpx.get(f"{address}/main.js")
        assert script.headers["content-type"].startswith("text/javascript")
        assert httpx.get(f"{address}/a.gsyn").content == DATA


def test_a_missing_root_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        root_of(tmp_path / "none")
