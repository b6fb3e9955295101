"""Annotations saved by a page of our own: who may, and what becomes of the file."""

import json
from collections.abc import Generator
from pathlib import Path

import httpx
import numpy as np
import pytest

from gsynopsis.cli import main
from gsynopsis.container import encode
from gsynopsis.container.annotate import annotations_of
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.page import FOLDER
from gsynopsis.serve.run import serving
from tests.container.notes.test_annotations import ONE
from tests.level_sets import make_level_set

PLACE = "/scene.gsyn/annotations"
TEXT = json.dumps([ONE])


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "scene.gsyn"
    path.write_bytes(encode(make_level_set(np.random.default_rng(1)), "compact"))
    return path


@pytest.fixture
def client(file: Path) -> Generator[httpx.Client]:
    app = make_app(root_of(file.parent), viewer=FOLDER, edit=True)
    with serving(app) as address, httpx.Client(base_url=address) as client:
        yield client


def put(client: httpx.Client, text: str, place: str = PLACE, **headers: str) -> httpx.Response:
    origin = str(client.base_url).rstrip("/")
    return client.put(place, content=text, headers={"origin": origin, **headers})


def test_our_own_page_saves_and_says_that_it_can(client: httpx.Client, file: Path) -> None:
    assert "<body data-edit>" in client.get("/").text
    tag = client.head("/scene.gsyn").headers["etag"]
    assert put(client, TEXT).status_code == 204
    assert json.loads(annotations_of(file)) == [ONE]
    assert client.head("/scene.gsyn").headers["etag"] != tag


def test_nobody_else_may_and_what_is_wrong_changes_nothing(
    client: httpx.Client, file: Path
) -> None:
    before = file.read_bytes()
    refused = {
        403: [
            client.put(PLACE, content=TEXT),
            put(client, TEXT, origin="https://evil.example"),
            put(client, TEXT, host="evil.example", origin="http://evil.example"),
        ],
        404: [put(client, TEXT, "/other.gsyn/annotations")],
        400: [put(client, "{"), put(client, json.dumps([{**ONE, "at": [1]}]))],
        413: [put(client, "[" + " " * 70000 + "]")],
        405: [client.put("/scene.gsyn", content=TEXT)],
    }
    for status, answers in refused.items():
        assert [answer.status_code for answer in answers] == [status] * len(answers)
    assert file.read_bytes() == before


def test_without_edit_nothing_is_written(file: Path) -> None:
    before = file.read_bytes()
    app = make_app(root_of(file), viewer=FOLDER)
    with serving(app) as address, httpx.Client(base_url=address) as client:
        assert put(client, TEXT).status_code == 405
        assert "<body>" in client.get("/").text
    assert file.read_bytes() == before


def test_edit_is_for_this_machine_alone(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["serve", str(file), "--edit", "--host", "0.0.0.0", "--port", "0"]) == 2
    assert "--edit" in capsys.readouterr().err
