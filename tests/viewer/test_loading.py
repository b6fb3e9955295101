"""How the browser reads a file: each byte once, damage again, a cut file as far as it is whole."""

import asyncio
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.datastructures import Headers
from starlette.types import Receive, Scope, Send

from benchmarks.viewer.browser import MISSING, pages, pinhole, pixels, psnr, visit
from gsynopsis.container import decode
from gsynopsis.container.index import parse_index
from gsynopsis.container.layout import Kind
from gsynopsis.container.writer import encode_with_account
from gsynopsis.serve.page import single_page
from gsynopsis.serve.run import serving
from gsynopsis.stream.bootstrap import FIRST_BYTES
from tests.level_sets import make_level_set
from tests.viewer.bright import LEAST_DB, SHAPE, bright_levels, camera_of, drawn_by_cpu
from tests.viewer.unseen import UNSEEN
from tests.viewer.watched import Span, Watched, read_once

pytestmark = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"
)
NOTE = "viewer().shadowRoot.querySelector('.note')"
SAID = f"{NOTE}.hidden ? '' : {NOTE}.textContent"


@pytest.fixture(scope="module")
def blocks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bright scene, uncompressed and in many blocks: 143 kB, no level on a round number."""
    path = tmp_path_factory.mktemp("blocks") / "blocks.gsyn"
    levels = bright_levels()
    # A part of the base is to be seen on the page.
    levels.shared.log_scales[:, 3:] += 0.7
    path.write_bytes(encode_with_account(levels, "raw", block=64)[0])
    return path


@pytest.mark.parametrize("query", ["", "?content=blocks.gsyn"])
def test_the_first_bytes_are_asked_for_before_the_script_is_there(
    query: str, blocks: Path, tmp_path: Path
) -> None:
    """The server keeps the script back until then."""
    watched = Watched(blocks)
    asked: list[str] = []
    early: list[bool] = []

    async def patient(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["path"].endswith(".gsyn"):
            asked.append(Headers(scope=scope)["range"])
        if scope["path"].endswith(".js"):
            deadline = time.monotonic() + 20
            while not watched.spans and time.monotonic() < deadline:
                await asyncio.sleep(0.01)
            early.append(bool(watched.spans))
        await watched(scope, receive, send)

    with serving(patient) as address:
        found = visit(f"{address}/{query}", tmp_path, [{"wait": "complete"}])
    assert early and all(early), "the script came by the deadline alone"
    assert read_once(watched.spans, blocks.stat().st_size), sorted(watched.spans)
    assert [event["level"] for event in found.times("level-ready")] == [0, 1, 2, 3]
    base = parse_index(blocks.read_bytes(), "blocks").levels[0].end
    assert asked[0] == f"bytes=0-{(40960 if query else base) - 1}", "our own page knows the base"


def test_a_base_of_several_blocks_shows_block_by_block(blocks: Path, tmp_path: Path) -> None:
    """The server keeps the last block of the base back until pixels of those before are seen."""
    data = blocks.read_bytes()
    held = parse_index(data, "blocks").levels[0].end - 50
    watched = Watched(blocks, held=held)
    look = "new Promise((done) => { const look = () => { if (viewer().scene?.drawn) done(lit());"
    look += " else requestAnimationFrame(look); }; look(); })"
    lit = (
        "globalThis.lit = () => { const { pixels } = viewer().scene.capture();"
        " return pixels.filter((value, i) => i % 4 < 3 && value > 30).length / pixels.length; }"
    )
    steps: list[dict[str, Any]] = [
        {"name": "first", "script": look},
        {"name": "ready", "script": "seen.filter((event) => event.name === 'base-ready').length"},
        {"name": "_", "script": "fetch('go').then(() => 0)"},
        {"wait": "complete"},
        {"name": "base", "script": "picture(null, 0).then(() => lit())"},
        {"name": "finest", "script": f"picture({pinhole(camera_of(bright_levels()))}, 3)"},
    ]
    with serving(watched) as address:
        found = visit(f"{address}/?noui&content=blocks.gsyn", tmp_path, steps, init=lit).results
    assert found["ready"] == 0
    assert 0.02 < found["first"] < found["base"]
    levels = decode(data, "scene")
    expected = drawn_by_cpu(levels, camera_of(levels))[3]
    assert psnr(pixels(found["finest"]), expected) >= LEAST_DB


@pytest.mark.parametrize("query", ["", "&split=0", "&level=1"])
def test_each_byte_is_read_once(query: str, blocks: Path, tmp_path: Path) -> None:
    watched = Watched(blocks)
    steps: list[dict[str, Any]] = [
        {"wait": "complete"},
        {"name": "more", "script": "viewer().scene.setLevel(3), 0"},
        {"name": "_", "script": "viewer().scene.settled().then(() => 0)"},
    ]
    with serving(watched) as address:
        found = visit(f"{address}/?noui{query}", tmp_path, steps)
    size = blocks.stat().st_size
    assert read_once(watched.spans, size), sorted(watched.spans)
    assert found.times("complete")[0]["bytes"] == size
    assert [event["level"] for event in found.times("level-ready")] == [0, 1, 2, 3]


def test_directories_in_pages_are_read_once_too(tmp_path: Path) -> None:
    """Of the base page by page with its blocks, of finer levels as they are wanted."""
    file = tmp_path / "paged.gsyn"
    file.write_bytes(encode_with_account(bright_levels(), "raw", block=16, page=4)[0])
    index = parse_index(file.read_bytes(), "paged")
    assert index.paged and index.header.front
    watched = Watched(file)
    steps: list[dict[str, Any]] = [
        {"wait": "complete"},
        {"name": "finest", "script": f"picture({pinhole(camera_of(bright_levels()))}, 3)"},
    ]
    with serving(watched) as address:
        found = visit(f"{address}/?noui&content=paged.gsyn", tmp_path, steps, init=UNSEEN)
    assert read_once(watched.spans, file.stat().st_size), sorted(watched.spans)
    assert [event["level"] for event in found.times("level-ready")] == [0, 1, 2, 3]
    levels = decode(file.read_bytes(), "scene")
    expected = drawn_by_cpu(levels, camera_of(levels))[3]
    assert psnr(pixels(found.results["finest"]), expected) >= LEAST_DB


def test_each_byte_of_a_base_longer_than_the_first_request_is_read_once(tmp_path: Path) -> None:
    """The rest of the base is asked for while the first request runs."""
    shape = replace(SHAPE, anchors=(2500, 2600, 2700, 2800))
    file = tmp_path / "long.gsyn"
    file.write_bytes(encode_with_account(make_level_set(np.random.default_rng(3), shape), "raw")[0])
    data = file.read_bytes()
    base = parse_index(data, "long").levels[0].end
    assert base > 1.5 * FIRST_BYTES
    watched = Watched(file)
    with serving(watched) as address:
        visit(f"{address}/?noui", tmp_path, [{"wait": "complete"}])
    assert read_once(watched.spans, len(data)), sorted(watched.spans)


def test_each_byte_of_each_version_is_read_once_while_a_file_is_followed(
    blocks: Path, bright: Path, tmp_path: Path
) -> None:
    file = tmp_path / "live.gsyn"
    file.write_bytes(bright.read_bytes())
    watched = Watched(file)
    second = "seen.filter((event) => event.name === 'complete').length > 1"
    steps: list[dict[str, Any]] = [
        {"wait": "complete"},
        {"name": "_", "script": "fetch('listing.json').then(() => 0)"},
        {
            "name": "_",
            "script": f"(async () => {{ while (!({second})) "
            "await new Promise((r) => setTimeout(r, 50)); })()",
        },
    ]
    app = watched.app

    async def replaced(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["path"] == "/listing.json":
            first, watched.spans = watched.spans, []
            assert read_once(first, len(bright.read_bytes()))
            other = file.with_suffix(".tmp")
            other.write_bytes(blocks.read_bytes())
            other.replace(file)
        await app(scope, receive, send)

    watched.app = replaced
    with serving(watched) as address:
        visit(f"{address}/?noui&content=live.gsyn&live=0.2", tmp_path, steps)
    assert read_once(watched.spans, blocks.stat().st_size)


def damaged(times: int, spans: list[Span]) -> Callable[[bytes, Span], bytes]:
    """Flip a bit in each of these spans the first so many times that it is sent."""
    sent: Counter[Span] = Counter()

    def change(body: bytes, at: Span) -> bytes:
        changed = bytearray(body)
        for span in spans:
            place = (span[0] + span[1]) // 2
            if at[0] <= place < at[1]:
                sent[span] += 1
                if sent[span] <= times:
                    changed[place - at[0]] ^= 16
        return bytes(changed)

    return change


def pieces_of(data: bytes) -> dict[str, Span]:
    """Where some parts of a file lie: index, manifest, a directory, networks and blocks."""
    index = parse_index(data, "file")
    found: dict[str, Span] = {"index": (40, 48)}
    for chunk in index.chunks:
        name = f"{Kind(chunk.kind).label} {chunk.level}"
        found[name] = (chunk.offset, chunk.offset + chunk.stored)
    return found


def test_what_comes_damaged_is_asked_for_again(blocks: Path, tmp_path: Path) -> None:
    data = blocks.read_bytes()
    spans = list(pieces_of(data).values())
    watched = Watched(blocks, damaged(3, spans))
    levels = decode(data, "scene")
    camera = camera_of(levels)
    steps = [{"wait": "complete"}, {"name": "finest", "script": f"picture({pinhole(camera)}, 3)"}]
    with serving(watched) as address:
        found = visit(f"{address}/?noui", tmp_path, steps)
    assert not found.times("error")
    assert psnr(pixels(found.results["finest"]), drawn_by_cpu(levels, camera)[3]) >= LEAST_DB
    again = sum(stop - start for start, stop in watched.spans) - len(data)
    assert 0 < again < len(data), "only what was damaged is asked for again"


@pytest.mark.parametrize(
    ("part", "name"), [("blocks 1", "level 1 block"), ("manifest 0", "manifest")]
)
def test_what_comes_damaged_four_times_is_named(
    part: str, name: str, blocks: Path, tmp_path: Path
) -> None:
    watched = Watched(blocks, damaged(4, [pieces_of(blocks.read_bytes())[part]]))
    with serving(watched) as address:
        found = visit(f"{address}/?noui", tmp_path, [{"wait": "error"}])
    (error,) = found.times("error")
    assert error["message"].startswith(name) and "the bytes were changed" in error["message"]
    assert error["trouble"] == "ChecksumError"


def test_a_file_that_was_cut_is_the_levels_that_it_holds(blocks: Path, tmp_path: Path) -> None:
    """Over HTTP, dropped, and inside a page; a page that follows a file waits for all of it."""
    data = blocks.read_bytes()
    ends = [level.end for level in parse_index(data, "blocks").levels]
    cuts = {"one.gsyn": ends[0] + 5, "three.gsyn": len(data) - 5}
    for name, length in cuts.items():
        (tmp_path / name).write_bytes(data[:length])
    (tmp_path / "none.gsyn").write_bytes(data[: ends[0] - 1])
    (tmp_path / "longer.gsyn").write_bytes(data + b"x")
    levels = decode(data, "scene")
    camera = camera_of(levels)
    look = f"picture({pinhole(camera)}, 3)"
    drop = (
        "fetch('one.gsyn').then((answer) => answer.blob()).then((blob) => {"
        " const held = new DataTransfer(); held.items.add(new File([blob], 'one.gsyn'));"
        " viewer().dispatchEvent(new DragEvent('drop', { dataTransfer: held }));"
        " return new Promise((done) => viewer().addEventListener('complete', done,"
        " { once: true })); }).then(() => 0)"
    )
    steps: list[dict[str, Any]] = [
        {"wait": "complete"},
        {"name": "three", "script": look},
        {"name": "three says", "script": SAID},
        {"name": "_", "script": drop},
        {"name": "one", "script": look},
        {"name": "one says", "script": SAID},
    ]
    for name in ("none", "longer"):
        wait = (
            "new Promise((done) => viewer().addEventListener('viewer-error', () => done("
            f"{NOTE}.textContent), {{ once: true }}))"
        )
        steps.append({"name": name, "script": f"viewer().open('{name}.gsyn'), {wait}"})
    with pages(tmp_path) as address:
        found = visit(f"{address}/?noui&content=three.gsyn", tmp_path, steps).results
    pictures = drawn_by_cpu(levels, camera)
    assert psnr(pixels(found["three"]), pictures[2]) >= LEAST_DB
    assert psnr(pixels(found["one"]), pictures[0]) >= LEAST_DB
    assert "was cut" in found["three says"] and "levels 0 to 2 of 3" in found["three says"]
    assert f"{cuts['one.gsyn']} of {len(data)} bytes" in found["one says"]
    assert "incomplete" in found["none"] and str(ends[0]) in found["none"]
    assert "incomplete" in found["longer"]


def test_a_page_with_a_scene_that_was_cut_shows_what_it_holds(blocks: Path, tmp_path: Path) -> None:
    data = blocks.read_bytes()
    page = tmp_path / "cut.html"
    page.write_text(single_page("cut.gsyn", data[: len(data) // 2]), encoding="utf-8")
    steps: list[dict[str, Any]] = [{"wait": "complete"}, {"name": "says", "script": SAID}]
    found = visit(page.as_uri(), tmp_path, steps)
    assert [event["level"] for event in found.times("level-ready")] == [0, 1]
    assert "was cut" in found.results["says"] and not found.times("error")
