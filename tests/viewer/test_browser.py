"""The viewer in real Chromium: what it shows, when, and what it says of trouble."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from benchmarks.viewer.browser import MISSING, SIZE, pages, pinhole, pixels, psnr, visit
from gsynopsis.container import annotated, decode, describe, encode
from gsynopsis.container.index import parse_index
from gsynopsis.model.training_focals import focals_text
from gsynopsis.records import FOCALS_NOTE as FOCALS
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.page import single_page
from gsynopsis.serve.run import serving
from gsynopsis.stream.trace import steady
from gsynopsis.stream.virtual import Link
from tests.viewer.bright import LEAST_DB, bright_levels, camera_of, drawn_by_cpu
from tests.viewer.plain_hosts import plain_host
from tests.viewer.unseen import UNSEEN

pytestmark = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"
)


def test_every_level_looks_as_the_cpu_renderer_draws_it(bright: Path, tmp_path: Path) -> None:
    levels = decode(bright.read_bytes(), "scene")
    camera = camera_of(levels)
    names = [f"L{k}" for k in range(len(levels.levels))]
    shots = [
        {"name": name, "script": f"picture({pinhole(camera)}, {k})"} for k, name in enumerate(names)
    ]
    # Down again: what was refined must not show in the coarse level.
    again = {"name": "again", "script": f"picture({pinhole(camera)}, 0)"}
    with pages(bright) as address:
        found = visit(
            f"{address}/?noui", tmp_path, [{"wait": "complete"}, *shots, again], init=UNSEEN
        )
    pictures = drawn_by_cpu(levels, camera)
    for name, expected in zip(names, pictures, strict=True):
        assert psnr(pixels(found.results[name]), expected) >= LEAST_DB, name
    assert psnr(pixels(found.results["again"]), pictures[0]) >= LEAST_DB
    assert psnr(pictures[0], pictures[3]) < LEAST_DB, "levels of the test scene look the same"
    assert found.results["L3"]["pixels"] != found.results["L0"]["pixels"]


@pytest.mark.parametrize("times", [0.2, 5.0])
def test_pictures_of_another_size_are_drawn_as_the_cpu_renderer_does(
    times: float, tmp_path: Path
) -> None:
    """Photos of training had `times` the focal length of the picture; level 1 alone as here."""
    plain = bright_levels()
    plain.shared.log_scales[:, 3:] -= 1
    camera = camera_of(plain)
    focals = [(times * 210.0, times * 215.0)] * 4
    focals[1] = (200.0, 220.0)
    levels = replace(plain, meta={FOCALS: focals_text(focals)})
    file = tmp_path / "small.gsyn"
    file.write_bytes(encode(levels, "raw"))
    steps: list[dict[str, Any]] = [{"wait": "complete"}]
    steps += [{"name": f"L{k}", "script": f"picture({pinhole(camera)}, {k})"} for k in range(4)]
    with pages(file) as address:
        found = visit(f"{address}/?noui", tmp_path, steps, init=UNSEEN)
    expected, without = drawn_by_cpu(levels, camera), drawn_by_cpu(plain, camera)
    for k in range(4):
        assert psnr(pixels(found.results[f"L{k}"]), expected[k]) >= LEAST_DB, k
        assert (psnr(without[k], expected[k]) < LEAST_DB) == (k != 1), k


def test_the_base_shows_before_all_is_there_and_a_broken_line_is_mended(
    bright: Path, tmp_path: Path
) -> None:
    """On a slow line that breaks three times, the file on another host than the page."""
    size = bright.stat().st_size
    link = Link(steady(0.2), 0.01, (size // 8, size // 2, size * 3 // 4))
    slow = make_app(root_of(bright), link=link)
    with pages(tmp_path) as address, serving(slow) as other:
        url = f"{address}/?noui&content={other}/{bright.name}"
        found = visit(url, tmp_path, [{"wait": "complete"}])
    levels = found.times("level-ready")
    assert [event["level"] for event in levels] == [0, 1, 2, 3]
    (base,), (complete,) = found.times("base-ready"), found.times("complete")
    assert base["bytes"] < 0.6 * size < size <= complete["bytes"]
    assert base["at"] < complete["at"] - 200
    assert not found.times("error")


NOTE = "viewer().shadowRoot.querySelector('.note').textContent"


def opened(name: str, event: str) -> str:
    """A script: the note on the page when a file that is opened has come so far."""
    listen = f"viewer().addEventListener('{event}', () => done({NOTE}), {{ once: true }})"
    return f"new Promise((done) => {{ {listen}; viewer().open('{name}'); }})"


def test_what_cannot_be_shown_is_said_in_a_sentence(small: Path, tmp_path: Path) -> None:
    data = small.read_bytes()
    flipped, newer = bytearray(data), bytearray(data)
    flipped[-9] ^= 4
    newer[8] = 2
    base = parse_index(data, "scene").levels[0].end
    bad = {
        "other.gsyn": (b"PK" + data[2:], "This is no .gsyn file."),
        "short.gsyn": (data[: base - 5], "incomplete"),
        "flipped.gsyn": (bytes(flipped), "the bytes were changed"),
        "newer.gsyn": (bytes(newer), "a newer viewer is needed"),
        "empty.gsyn": (b"", ""),
        "missing.gsyn": (None, "There is no such file"),
    }
    (tmp_path / "scene.gsyn").write_bytes(data)
    steps: list[dict[str, Any]] = [{"wait": "complete"}]
    for name, (content, _) in bad.items():
        if content is not None:
            (tmp_path / name).write_bytes(content)
        steps.append({"name": name, "script": opened(name, "viewer-error")})
    steps.append({"name": "after", "script": opened("scene.gsyn", "base-ready")})
    with pages(tmp_path) as address:
        found = visit(f"{address}/?noui&content=scene.gsyn", tmp_path, steps)
    for name, (_, words) in bad.items():
        assert words in found.results[name] and found.results[name], name
    assert len(found.times("error")) == len(bad)
    assert found.results["after"] == "", "a good file after a bad one shows again"
    assert not [line for line in found.said if line.startswith("pageerror")]


def test_a_host_without_ranges_and_one_that_refuses(small: Path, tmp_path: Path) -> None:
    with (
        plain_host(small.parent) as plain,
        plain_host(small.parent, closed=True) as closed,
        pages(tmp_path) as address,
    ):
        steps = [
            {"wait": "complete"},
            {"name": "_", "script": f"viewer().open('http://127.0.0.1:{closed}/{small.name}')"},
            {"until": f"!['', 'Loading…'].includes({NOTE})"},
            {"name": "refused", "script": NOTE},
        ]
        content = f"http://127.0.0.1:{plain}/{small.name}"
        found = visit(f"{address}/?noui&content={content}", tmp_path, steps)
    assert [event["level"] for event in found.times("level-ready")] == [0, 1, 2, 3]
    assert "(CORS)" in found.results["refused"]


POSE = "viewer().scene.camera.pose"
FACTS = "(viewer().shadowRoot.querySelector('.facts')?.innerText ?? '')"


def test_mouse_keyboard_and_touch_move_the_camera(small: Path, tmp_path: Path) -> None:
    def touch(kind: str, number: int, x: int, y: int) -> str:
        place = f"pointerId: {number}, pointerType: 'touch', clientX: {x}, clientY: {y}"
        return f"stage.dispatchEvent(new PointerEvent('{kind}', {{{place}, bubbles: true}}));"

    pinch = "const stage = viewer().shadowRoot.querySelector('.stage');"
    pinch += touch("pointerdown", 1, 100, 80) + touch("pointerdown", 2, 140, 80)
    pinch += touch("pointermove", 2, 180, 80) + touch("pointerup", 1, 0, 0)
    pinch += touch("pointerup", 2, 0, 0)
    steps = [
        {"wait": "complete"},
        {"name": "start", "script": POSE},
        {"drag": [[60, 60], [120, 70]]},
        {"name": "orbited", "script": POSE},
        {"drag": [[60, 60], [90, 60]], "button": "right"},
        {"name": "panned", "script": POSE},
        {"press": "KeyW", "delay": 150},
        {"name": "flown", "script": POSE},
        {"name": "pinched", "script": f"{{ {pinch} }} {POSE}"},
        {"press": "Home"},
        {"name": "home", "script": POSE},
        {"press": "BracketRight"},
        {"name": "next", "script": POSE},
        {"press": "KeyI"},
        {"until": f"{FACTS}.includes('L3')"},
        {"name": "facts", "script": FACTS},
    ]
    with pages(small) as address:
        found = visit(f"{address}/?noui", tmp_path, steps).results
    assert found["orbited"]["forward"] != found["start"]["forward"]
    assert found["orbited"]["distance"] == pytest.approx(found["start"]["distance"])
    assert found["panned"]["forward"] == found["orbited"]["forward"]
    assert found["panned"]["position"] != found["orbited"]["position"]
    ahead = np.subtract(found["flown"]["position"], found["panned"]["position"])
    assert ahead @ found["panned"]["forward"] > 0
    assert found["pinched"]["distance"] == pytest.approx(found["flown"]["distance"] / 2)
    assert found["home"] == found["start"] != found["next"]
    assert "L3" in found["facts"] and "splats" in found["facts"] and "dB" in found["facts"]


def test_a_page_in_one_file_needs_no_server(bright: Path, tmp_path: Path) -> None:
    page = tmp_path / "scene.html"
    page.write_text(single_page(bright.name, bright.read_bytes()), encoding="utf-8")
    found = visit(
        page.as_uri(),
        tmp_path,
        [
            {"wait": "complete", "timeout": 20000},
            {"name": "_", "script": "viewer().scene.settled()"},
            {"shot": "page"},
        ],
    )
    assert found.times("base-ready") and not found.times("error")
    image = np.asarray(Image.open(tmp_path / "page.png").convert("RGB"), np.float64)
    assert image[: SIZE[1] // 2].std() > 10, "the page is blank"


def test_memory_stays_steady_over_level_changes(small: Path, tmp_path: Path) -> None:
    there = "picture(null, 3).then(() => viewer().scene.memory)"
    back = "picture(null, 0).then(() => viewer().scene.memory)"
    steps: list[dict[str, Any]] = [{"wait": "complete"}, {"name": "first", "script": there}]
    steps += [{"name": f"{k}", "script": back if k % 2 else there} for k in range(1, 11)]
    with pages(small) as address:
        found = visit(f"{address}/?noui", tmp_path, steps, init=UNSEEN).results
    total = found["first"]["tables"] + found["first"]["decoded"]
    assert found["first"]["kernel"] == "wasm"
    assert found["10"]["tables"] + found["10"]["decoded"] == total


def test_buffers_and_webassembly_of_page_and_workers_count_as_memory(
    bright: Path, tmp_path: Path
) -> None:
    """Else the memory that the note tells would lack what the decoder takes most of."""
    script = "new Blob(['globalThis.kept = new Uint8Array(8 << 20); postMessage(1)'])"
    inside = (
        f"new Promise((done) => {{ globalThis.kept = new Worker(URL.createObjectURL({script}));"
        "kept.onmessage = () => done(0); })"
    )
    wasm = "(globalThis.held = new WebAssembly.Memory({ initial: 512 }), 0)"
    steps: list[dict[str, Any]] = [
        {"wait": "complete"},
        {"name": "_", "script": "viewer().scene.settled()"},
        {"heap": "before"},
        {"name": "_", "script": wasm},
        {"heap": "wasm"},
        {"name": "_", "script": inside},
        {"heap": "worker"},
    ]
    with pages(bright) as address:
        found = visit(f"{address}/?noui", tmp_path, steps, heap=True).results
    before, wasm_held, worker = (found[name] for name in ("before", "wasm", "worker"))
    assert before["isolates"] == 3 and worker["isolates"] == 4
    assert before["wasm"] > 0, "the decoder's own memory is not seen"
    assert wasm_held["wasm"] - before["wasm"] == 32 << 20
    assert worker["buffers"] - wasm_held["buffers"] == pytest.approx(8 << 20, abs=1 << 20)
    assert worker["peak"]["total"] >= before["objects"] + (32 << 20)


def test_decibels_name_the_size_of_their_pictures(small: Path, tmp_path: Path) -> None:
    named = tmp_path / "named.gsyn"
    quality = [dict(level.quality) for level in describe(small).levels]
    said: list[str] = []
    for text in ("480 x 320", "<b>no size"):
        data = annotated(small.read_bytes(), {"pictures": text}, quality, "named")
        named.write_bytes(data)
        with pages(named) as address:
            steps: list[dict[str, Any]] = [
                {"press": "KeyI"},
                {"until": f"{FACTS}.includes('dB')"},
                {"name": "facts", "script": FACTS},
            ]
            said.append(visit(f"{address}/?noui", tmp_path, steps).results["facts"])
    assert "dB: photos of 480 x 320" in said[0]
    assert "photos of" not in said[1] and "dB" in said[1]
