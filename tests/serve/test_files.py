"""What of a folder may be had, and under which names."""

import errno
import os
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path
from urllib.parse import quote

import httpx
import pytest

from gsynopsis.errors import InputError
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import address_of, root_of, tag_of
from gsynopsis.serve.run import serving

DATA = bytes(range(250)) * 4
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


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    base = tmp_path_factory.mktemp("serve")
    root = base / "root"
    (root / "deep").mkdir(parents=True)
    (root / "a.gsyn").write_bytes(DATA)
    (root / "deep" / "b.gsyn").write_bytes(DATA[:10])
    (root / "empty.gsyn").write_bytes(b"")
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
    (root / "in.gsyn").symlink_to(root / "a.gsyn")
    (root / "loop").symlink_to(root / "loop")
    (root / "around.gsyn").symlink_to(root / "around.gsyn")
    (root / "hidden.gsyn").symlink_to(root / ".hidden.gsyn")
    (root / "stored.gsyn").symlink_to(root / ".store" / "deep" / "d.gsyn")
    (root / "store").symlink_to(root / ".store")
    (root / "folder.gsyn").mkdir()
    os.mkfifo(root / "pipe.gsyn")
    return root


@pytest.fixture(scope="module")
def client(folder: Path) -> Iterator[httpx.Client]:
    with serving(make_app(root_of(folder))) as address, httpx.Client(base_url=address) as client:
        yield client


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
        "/a.GSYN",
        "http://127.0.0.1/../secret.gsyn",
        *(f"/{quote(name)}" for name in OTHERS),
        *(f"/{quote(name)}.gsyn" for name in OTHERS),
    ],
)
def test_nothing_but_scenes_of_the_root_is_served(client: httpx.Client, name: str) -> None:
    # httpx tidies up paths; a hostile client does not.
    connection = HTTPConnection(client.base_url.host, client.base_url.port or 80)
    connection.request("GET", name)
    answer = connection.getresponse()
    assert answer.status == 404
    assert b"secret" not in answer.read()
    connection.close()


def test_every_name_can_be_asked_for_as_the_list_and_the_page_write_it(
    client: httpx.Client,
) -> None:
    files = client.get("/listing.json").json()["files"]
    urls = [file["url"] for file in files]
    assert len(files) == len(ODD) + 4
    for name in ODD:
        assert address_of(os.fsdecode(name)) in urls
        assert client.get(f"/{address_of(os.fsdecode(name))}").content == name
    page = client.get("/").text
    for url in urls:
        assert f'href="{url}"' in page
    assert "<b>&amp;'" not in page and "\x1b" not in page.replace("\x1b[31m", "?")


def test_links_within_the_root_and_subfolders_are_served(client: httpx.Client) -> None:
    assert client.get("/in.gsyn").content == DATA
    assert client.get("/deep/b.gsyn").content == DATA[:10]


def test_a_changed_file_has_another_tag(folder: Path, client: httpx.Client) -> None:
    path = folder / "c.gsyn"
    path.write_bytes(b"one")
    before = client.head("/c.gsyn").headers["etag"]
    path.write_bytes(b"two")
    assert client.head("/c.gsyn").headers["etag"] != before
    path.unlink()


def test_the_tag_tells_files_apart_that_the_clock_does_not(folder: Path) -> None:
    # The clock of a file system stands still for milliseconds, and numbers of files come again.
    state = (folder / "a.gsyn").stat()
    assert tag_of(state, b"one") != tag_of(state, b"two")


def test_no_descriptor_left_is_told_from_no_file(
    folder: Path, monkeypatch: pytest.MonkeyPatch, client: httpx.Client
) -> None:
    real = os.open

    def full(path: object, flags: int, *more: object, **named: object) -> int:
        if str(path).endswith("a.gsyn"):
            raise OSError(errno.EMFILE, "Too many open files")
        return real(path, flags, *more, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(os, "open", full)
    answer = client.get("/a.gsyn")
    assert (answer.status_code, answer.headers["retry-after"]) == (503, "1")


def test_one_file_is_served_alone(folder: Path) -> None:
    with serving(make_app(root_of(folder / "a.gsyn"))) as address:
        assert httpx.get(f"{address}/a.gsyn").content == DATA
        assert httpx.get(f"{address}/empty.gsyn").status_code == 404
        assert len(httpx.get(f"{address}/listing.json").json()["files"]) == 1


def test_a_missing_root_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        root_of(tmp_path / "none")


@pytest.mark.parametrize("name", ["run.json", ".hidden.gsyn", "pipe.gsyn", "loop"])
def test_what_is_no_scene_is_refused_as_a_root(folder: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"\.gsyn file"):
        root_of(folder / name)
