"""The element in pages that move it, open files early, give it no height, or are strict."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.viewer.browser import MISSING, screenshot, visit
from tests.viewer.element_site import site

pytestmark = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"
)
MODULE = '<script type="module" src="gsynopsis-viewer.js"></script>'
PLAIN = f"""<!doctype html><style>body {{ margin: 0 }} #two {{ width: 320px }}</style>{MODULE}
<div id="one"></div><div id="two"></div>"""
POLICY = (
    "default-src 'none'; script-src 'self' blob: 'wasm-unsafe-eval'; worker-src 'self' blob:; "
    "connect-src 'self'"
)
"""What docs/viewer.md says that a page has to allow."""
STRICT = f"""<!doctype html><meta http-equiv="Content-Security-Policy" content="{POLICY}">
{MODULE}<gsynopsis-viewer src="scene.gsyn"></gsynopsis-viewer>"""
RATIO = """
const usual = matchMedia;
const queries = [];
globalThis.matchMedia = (text) => {
  if (!text.includes("dppx")) return usual(text);
  queries.push(new EventTarget());
  return queries.at(-1);
};
globalThis.turn = (ratio) => {
  Object.defineProperty(globalThis, "devicePixelRatio", { value: ratio, configurable: true });
  queries.at(-1).dispatchEvent(new Event("change"));
};
"""
"""A browser whose ratio a test turns: Chromium without a screen tells pages of no such change."""
SETTLED = {"name": "_", "script": "viewer().scene.settled()"}
TOOLS = {"until": "!!viewer().shadowRoot.querySelector('.bar')"}
COUNT = "seen.filter((event) => event.name === 'header').length"
BOX = "[viewer().clientWidth, viewer().clientHeight]"


def test_opened_before_it_is_in_the_page_moved_and_without_a_height(
    bright: Path, tmp_path: Path
) -> None:
    make = (
        "(globalThis.made = document.createElement('gsynopsis-viewer'),"
        " made.open('scene.gsyn'), document.querySelector('#one').append(made), 0)"
    )
    move = "(document.querySelector('#two').append(made), 0)"
    pose = "viewer().camera.position"
    steps: list[dict[str, Any]] = [
        {"until": "!!customElements.get('gsynopsis-viewer')"},
        {"name": "_", "script": make},
        {"wait": "complete"},
        {"name": "wide", "script": BOX},
        {"name": "_", "script": "viewer().next()"},
        {"name": "before", "script": pose},
        {"name": "_", "script": move},
        {"sleep": 200},
        SETTLED,
        {"name": "after", "script": pose},
        {"name": "narrow", "script": BOX},
        {"name": "headers", "script": COUNT},
        {"name": "canvas", "script": "viewer().shadowRoot.querySelector('canvas').width"},
        {"shot": "moved"},
        {"name": "_", "script": "made.remove()"},
        {"sleep": 50},
        {"name": "closed", "script": "made.scene"},
        {"name": "_", "script": "(document.querySelector('#one').append(made), 0)"},
        {"until": f"{COUNT} === 2 && viewer().scene.drawn > 0"},
    ]
    with site(tmp_path, bright, PLAIN) as address:
        found = visit(address, tmp_path, steps, (640, 800)).results
    assert found["wide"] == [640, 360], "16 : 9 where the page gives no height"
    assert found["narrow"] == [320, 180] and found["canvas"] == 320
    assert found["headers"] == 1, "a move is no new start"
    assert found["after"] == found["before"]
    assert screenshot(tmp_path / "moved.png")[:180, :320].std() > 0.05, "it is blank"
    assert found["closed"] is None


def test_a_page_that_forbids_inline_styles_has_all_of_it(small: Path, tmp_path: Path) -> None:
    bar = "getComputedStyle(viewer().shadowRoot.querySelector('.bar')).display"
    steps = [{"wait": "complete"}, TOOLS, {"name": "bar", "script": bar}]
    with site(tmp_path, small, STRICT) as address:
        found = visit(address, tmp_path, steps, (640, 480))
    assert found.results["bar"] == "flex"
    assert not [line for line in found.said if "Content Security Policy" in line]


def test_it_is_sharp_after_a_change_of_the_device_pixel_ratio(small: Path, tmp_path: Path) -> None:
    width = "viewer().shadowRoot.querySelector('canvas').width"
    steps: list[dict[str, Any]] = [{"wait": "complete"}, TOOLS]
    for ratio in (2, 1, 1.5):
        steps += [
            {"name": "_", "script": f"turn({ratio})"},
            {"until": f"{width} === {round(400 * ratio)}"},
        ]
    sized = "<style>gsynopsis-viewer { width: 400px; height: 300px }</style>"
    page = f'{sized}{MODULE}<gsynopsis-viewer src="scene.gsyn"></gsynopsis-viewer>'
    with site(tmp_path, small, page) as address:
        found = visit(address, tmp_path, [*steps, SETTLED], (640, 480), init=RATIO)
    assert not found.times("error")


def test_the_background_is_the_attribute_s_else_that_of_the_page(
    bright: Path, tmp_path: Path
) -> None:
    page = PLAIN.replace(
        '<div id="one">',
        "<style>gsynopsis-viewer { background: rgb(0, 90, 0) }</style>"
        '<div id="one"><gsynopsis-viewer src="scene.gsyn" noui></gsynopsis-viewer>',
    )
    far = "(viewer().camera = { position: [0, 0, -400], target: [0, 0, 0] }, 0)"
    picture = (
        "viewer().picture().then((blob) => createImageBitmap(blob)).then((bitmap) => {"
        " const pen = new OffscreenCanvas(9, 9).getContext('2d'); pen.drawImage(bitmap, 0, 0);"
        " return [...pen.getImageData(2, 2, 1, 1).data]; })"
    )
    steps: list[dict[str, Any]] = [
        {"wait": "complete"},
        TOOLS,
        {"name": "_", "script": "viewer().setAttribute('free', '')"},
        {"name": "_", "script": far},
        SETTLED,
        {"shot": "page"},
        {"name": "_", "script": "viewer().setAttribute('background', '#ffeedd')"},
        {"sleep": 100},
        {"shot": "own"},
        {"name": "picture", "script": picture},
    ]
    with site(tmp_path, bright, page) as address:
        found = visit(address, tmp_path, steps, (640, 480)).results
    for name, colour in {"page": (0, 90, 0), "own": (255, 238, 221)}.items():
        corner = 255 * screenshot(tmp_path / f"{name}.png")[3, 3]
        assert np.abs(corner - colour).max() <= 1, name
    assert found["picture"] == [255, 238, 221, 255]
