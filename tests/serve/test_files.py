"""Which scenes of a folder our server lists, and under which names."""

import os
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from gsynopsis.errors import InputError
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import address_of, root_of
from gsynopsis.serve.run import serving
from tests.serve.test_privacy import DATA, ODD


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    base = tmp_path_factory.mktemp("serve")
    root = base / "root"
    (root / "deep").mkdir(parents=True)
    (root / "a.gsyn").write_bytes(DATA)
    (root / "deep" / "b.gsyn").write_bytes(DATA[:10])
    (root / "empty.gsyn").write_bytes(b"")
    (root / ".hidden.gsyn").write_bytes(b"secret")
    for name in ODD:
        (root / os.fsdecode(name)).write_bytes(name)
    (root / "in.gsyn").symlink_to(root / "a.gsyn")
    (root / "loop").symlink_to(root / "loop")
    (root / "run.json").write_bytes(b"secret")
    os.mkfifo(root / "pipe.gsyn")
    return root


@pytest.fixture(scope="module")
def client(folder: Path) -> Iterator[httpx.Client]:
    with serving(make_app(root_of(folder))) as address, httpx.Client(base_url=address) as client:
        yield client


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
    path.write_bytes(b"other")
    assert client.head("/c.gsyn").headers["etag"] != before
    path.unlink()


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
