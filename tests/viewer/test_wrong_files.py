"""Files that are no scenes: what is shown stays, and the page says what to do."""

import gzip
from pathlib import Path
from typing import Any

import pytest

from benchmarks.viewer.browser import MISSING, pages, visit
from gsynopsis.container import annotated
from gsynopsis.serve.page import FOLDER, single_page
from tests.viewer.plain_hosts import plain_host

pytestmark = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"
)
NOTE = "viewer().shadowRoot.querySelector('.note').innerText"
PICTURE = "viewer().render(null, null).then(({ pixels }) => bytes(pixels))"


def dropped(name: str, content: str) -> str:
    """A script: drop a file, wait for the error; the note, and whether the scene is still drawn."""
    return (
        "new Promise((done) => { const carried = new DataTransfer();"
        f" carried.items.add(new File([{content}], '{name}'));"
        " viewer().addEventListener('viewer-error', ({ detail }) => setTimeout(() =>"
        f" done([{NOTE}, detail.trouble, viewer().scene.drawn > 0]), 50), {{ once: true }});"
        " viewer().dispatchEvent(new DragEvent('drop', { dataTransfer: carried })); })"
    )


def test_a_wrong_file_keeps_the_scene_and_is_named(bright: Path, tmp_path: Path) -> None:
    scene = tmp_path / "scene.gsyn"
    scene.write_bytes(bright.read_bytes())
    (tmp_path / "zipped.gsyn").write_bytes(gzip.compress(bright.read_bytes()))
    wrong = "new Promise((done) => { viewer().addEventListener('viewer-error', ({ detail }) =>"
    wrong += " done(detail.message), { once: true }); viewer().open('NAME'); })"
    steps: list[dict[str, Any]] = [
        {"wait": "complete"},
        {"until": "!!viewer().shadowRoot.querySelector('.bar')"},
        {"name": "before", "script": PICTURE},
        {"name": "ply", "script": dropped("room.ply", "'ply\\nformat'")},
        {"name": "spz", "script": dropped("room.spz", "new Uint8Array([31, 139, 8, 0])")},
        {"name": "sog", "script": dropped("room.sog", "'PK\\x03\\x04'")},
        {"name": "splat", "script": dropped("room.splat", "new Uint8Array(64)")},
        {"name": "other", "script": dropped("notes.txt", "'hello'")},
        {"name": "zipped", "script": wrong.replace("NAME", "zipped.gsyn")},
        {"name": "missing", "script": wrong.replace("NAME", "missing.gsyn")},
        {"name": "after", "script": PICTURE},
        {"name": "good", "script": "(viewer().open('scene.gsyn?again'), 0)"},
        {"until": "seen.filter(({ name }) => name === 'complete').length === 2"},
        {"name": "note", "script": NOTE},
    ]
    with pages(tmp_path) as address:
        found = visit(f"{address}/?noui&content=scene.gsyn", tmp_path, steps).results
    for name in ("ply", "spz", "sog", "splat"):
        note, trouble, drawn = found[name]
        assert f"`gsynopsis import room.{name}`" in note and drawn
        assert trouble == "NotGsynError"
    assert "gsynopsis import" in found["other"][0] and found["other"][2]
    assert "gzip" in found["zipped"]
    assert "There is no such file" in found["missing"]
    assert found["after"] == found["before"], "the scene stays as it was"
    assert found["note"] == ""


def test_splats_in_the_address_say_how_they_become_a_scene(small: Path, tmp_path: Path) -> None:
    (tmp_path / "room.ply").write_bytes(b"ply\n" + bytes(100))
    with plain_host(tmp_path) as port, pages(small) as address:
        steps = [{"wait": "error"}, {"name": "note", "script": NOTE}]
        other = f"http://127.0.0.1:{port}/room.ply"
        found = visit(f"{address}/?noui&content={other}", tmp_path, steps)
    assert "`gsynopsis import room.ply`" in found.results["note"]
    assert [event["trouble"] for event in found.times("error")] == ["NotGsynError"]


def test_a_host_that_refuses_is_told_to_the_page(small: Path, tmp_path: Path) -> None:
    """By CORS: it may answer later, so that it is no error yet."""
    hear = (
        "globalThis.notices = [];"
        "addEventListener('viewer-notice', ({ detail }) => notices.push(detail.message));"
    )
    with plain_host(small.parent, closed=True) as port, pages(tmp_path) as address:
        url = f"{address}/?noui&content=http://127.0.0.1:{port}/{small.name}"
        steps = [{"until": "notices.length > 0"}, {"name": "heard", "script": "notices[0]"}]
        found = visit(url, tmp_path, steps, init=hear).results
    assert "(CORS)" in found["heard"] and "Trying again" in found["heard"]


def test_pages_from_the_disk_say_what_to_do(small: Path, tmp_path: Path) -> None:
    beside = tmp_path / "beside.html"
    beside.write_text(single_page(small.name, None, "scene.gsyn"), encoding="utf-8")
    steps = [{"sleep": 300}, {"name": "text", "script": "document.body.innerText"}]
    for page in (FOLDER / "index.html", beside):
        found = visit(page.as_uri(), tmp_path, steps)
        assert "gsynopsis serve" in found.results["text"], page.name
        assert "gsynopsis view" in found.results["text"]
        assert not [line for line in found.said if line.startswith("pageerror")]


def test_the_title_is_the_scene_s_name(tmp_path: Path, small: Path) -> None:
    named = tmp_path / "named.gsyn"
    named.write_bytes(annotated(small.read_bytes(), {"scene": "The <b> room"}, None, "named"))
    (tmp_path / "plain.gsyn").write_bytes(annotated(small.read_bytes(), {"scene": ""}, None, "x"))
    found = {}
    with pages(tmp_path) as address:
        for name in ("named", "plain"):
            steps = [{"wait": "base-ready"}, {"name": "title", "script": "document.title"}]
            url = f"{address}/?content={name}.gsyn"
            found[name] = visit(url, tmp_path, steps).results["title"]
    assert found == {"named": "The <b> room", "plain": "plain"}
