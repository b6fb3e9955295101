"""Other programs' splats on a page of our server: imported by it, and shown."""

import base64
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

from benchmarks.viewer.browser import MISSING, visit
from gsynopsis.cli.dropped import COMMAND
from gsynopsis.jobs.import_splats import import_splats
from gsynopsis.serve import dropped
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.page import FOLDER
from gsynopsis.serve.run import serving
from tests.formats.trees import write_tree
from tests.viewer.imports import importing
from tests.viewer.plain_hosts import plain_host

pytestmark = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"
)
NOTE = "viewer().shadowRoot.querySelector('.note').innerText"
PICTURE = "viewer().render(null, null).then(({ pixels }) => bytes(pixels))"
READY = [{"wait": "complete"}, {"until": "!!viewer().shadowRoot.querySelector('.bar')"}]
SLOW = 170_000
"""Milliseconds until a process has imported a file, beside other tests."""


@pytest.fixture(scope="module")
def files(
    tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest
) -> dict[str, Path]:
    """Splats under the names that programs give them, and the scene of each in a folder."""
    folder = tmp_path_factory.mktemp("splats")
    (folder / "scenes").mkdir()
    found: dict[str, Path] = {}
    for kind, name in (("ply", "a tree.ply"), ("spz2", "leaves.spz")):
        if kind == "spz2":
            # The first one is imported by a process too, which knows of no fixture.
            request.getfixturevalue("few_tries")
        path = write_tree(folder / kind, kind).rename(folder / name)
        import_splats(path, folder / "scenes" / f"{path.stem}.gsyn", draft=True)
        found[name] = path
    return found


@pytest.fixture(scope="module")
def address(files: dict[str, Path]) -> Generator[str]:
    """A server of the scenes that imports as its command does, without a new process's start."""
    folder = files["a tree.ply"].parent / "scenes"
    with (
        importing() as command,
        serving(make_app(root_of(folder), viewer=FOLDER, imports=command)) as address,
    ):
        yield address


@pytest.fixture(scope="module")
def by_process(files: dict[str, Path]) -> Generator[str]:
    """The server as `gsynopsis serve` has it."""
    folder = files["a tree.ply"].parent / "scenes"
    with serving(make_app(root_of(folder), viewer=FOLDER, imports=COMMAND)) as address:
        yield address


def drop(name: str, data: bytes) -> str:
    """A script that drops a file; what the page says while it is on its way."""
    text = base64.b64encode(data).decode()
    return (
        "new Promise((done) => { const carried = new DataTransfer();"
        f" const content = Uint8Array.from(atob('{text}'), (c) => c.charCodeAt(0));"
        f" carried.items.add(new File([content], '{name}'));"
        " viewer().dispatchEvent(new DragEvent('drop', { dataTransfer: carried }));"
        f" const look = () => {NOTE} ? done({NOTE}) : setTimeout(look, 20); look(); }})"
    )


def count(event: str, number: int) -> dict[str, Any]:
    script = f"seen.filter(({{ name }}) => name === '{event}').length === {number}"
    return {"until": script, "timeout": SLOW}


def picture_of(address: str, path: Path, folder: Path) -> str:
    """Pixels of the scene that the command made of a file."""
    steps = [{"wait": "complete"}, {"name": "it", "script": PICTURE}]
    return visit(f"{address}/?noui&content={path.stem}.gsyn", folder, steps).results["it"]


@pytest.mark.parametrize(("name", "by"), [("a tree.ply", "by_process"), ("leaves.spz", "address")])
def test_dropped_splats_are_shown_as_their_import_is(
    name: str, by: str, files: dict[str, Path], tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    address: str = request.getfixturevalue(by)
    path = files[name]
    other = next(other for other in files.values() if other != path)
    steps: list[dict[str, Any]] = [
        *READY,
        {"name": "before", "script": PICTURE},
        {"name": "saying", "script": drop(name, path.read_bytes())},
        count("complete", 2),
        {"name": "it", "script": PICTURE},
        {"name": "title", "script": "document.title"},
        {"name": "note", "script": NOTE},
    ]
    found = visit(f"{address}/?noui&content={other.stem}.gsyn", tmp_path, steps)
    assert not found.times("error")
    assert found.results["saying"] == "Importing…" and found.results["note"] == ""
    assert found.results["title"] == path.stem
    assert found.results["it"] == picture_of(address, path, tmp_path)
    assert found.results["it"] != found.results["before"]


def test_a_broken_file_keeps_the_scene_and_is_one_line(
    address: str, files: dict[str, Path], tmp_path: Path
) -> None:
    broken = files["a tree.ply"].read_bytes()[:-7]
    steps: list[dict[str, Any]] = [
        *READY,
        {"name": "before", "script": PICTURE},
        {"name": "go", "script": drop("broken.ply", broken)},
        count("error", 1),
        {"sleep": 50},
        {"name": "note", "script": NOTE},
        {"name": "after", "script": PICTURE},
    ]
    found = visit(f"{address}/?noui&content=leaves.gsyn", tmp_path, steps)
    note = found.results["note"]
    assert note.startswith("broken.ply: ") and "\n" not in note and "/" not in note
    assert found.results["after"] == found.results["before"]
    assert [event["trouble"] for event in found.times("error")] == ["NotGsynError"]


def test_splats_in_the_address_are_shown_unless_another_site_led_here(
    address: str, files: dict[str, Path], tmp_path: Path
) -> None:
    folder = files["leaves.spz"].parent
    with plain_host(folder) as port:
        url = f"{address}/?noui&content=http://127.0.0.1:{port}/leaves.spz"
        steps = [{"wait": "complete", "timeout": SLOW}, {"name": "it", "script": PICTURE}]
        found = visit(url, tmp_path, steps)
        # A name and a number of this machine are two sites.
        (folder / "led.html").write_text(f'<a href="{url}">a scene</a>')
        steps = [
            {"name": "go", "script": "void document.querySelector('a').click()"},
            {"wait": "error"},
            {"name": "note", "script": NOTE},
        ]
        led = visit(f"http://localhost:{port}/led.html", tmp_path, steps)
    assert found.results["it"] == picture_of(address, files["leaves.spz"], tmp_path)
    assert "`gsynopsis import leaves.spz`" in led.results["note"]


def test_a_file_that_is_too_long_is_one_line(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The server answers before all of it has come, and does not read on."""
    monkeypatch.setattr(dropped, "BYTES_MAX", 1 << 20)
    script = drop("long.ply", b"ply").replace("[content]", "[content, new Uint8Array(64 << 20)]")
    steps = [*READY, {"name": "go", "script": script}, count("error", 1)]
    steps += [{"sleep": 50}, {"name": "note", "script": NOTE}]
    found = visit(f"{address}/?noui&content=leaves.gsyn", tmp_path, steps)
    assert found.results["note"].startswith("long.ply: found more than ")
