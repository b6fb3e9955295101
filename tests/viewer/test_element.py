"""The element in somebody else's page: events, attributes, methods, what it leaves alone."""

import base64
import io
import shutil
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from benchmarks.viewer.browser import MISSING, Visit, visit
from benchmarks.viewer.node import SCRIPTS
from gsynopsis.container import decode
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.run import serving

pytestmark = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"
)
PAGE = """<!doctype html><body style="margin: 0; height: 3000px">
<script type="module" src="gsynopsis-viewer.js"></script>
<style>gsynopsis-viewer { width: 400px; height: 300px }</style>
<div id="around"><gsynopsis-viewer src="scene.gsyn"></gsynopsis-viewer></div>
<input id="name">"""
POSE = "viewer().scene.camera.pose.position.map((v) => v.toFixed(6)).join()"
HELP = "viewer().shadowRoot.querySelector('.help').checkVisibility()"
TOUCH = "getComputedStyle(viewer().shadowRoot.querySelector('.stage')).touchAction"
READY: list[dict[str, Any]] = [{"wait": "complete"}]


@contextmanager
def site(folder: Path, scene: Path) -> Generator[str]:
    """A page with text fields, and the viewer as a part of it."""
    place = folder / "site"
    place.mkdir()
    for script in SCRIPTS:
        shutil.copy(script, place)
    (place / "index.html").write_text(PAGE)
    with serving(make_app(root_of(scene), viewer=place)) as address:
        yield address


def tour(scene: Path, folder: Path, steps: list[dict[str, Any]]) -> Visit:
    with site(folder, scene) as address:
        return visit(address, folder, [*READY, *steps], (640, 480))


NOTED = """
globalThis.wheels = [];
globalThis.keys = [];
addEventListener("wheel", (event) => { wheels.push(event.defaultPrevented); });
addEventListener("keydown", (event) => { keys.push([event.key, event.defaultPrevented]); });
"""
"""What the page around it gets to see of wheel and keys, and what of it was taken."""


def wheel(name: str, count: int) -> list[dict[str, Any]]:
    """Turn it; `name` is where the camera is afterwards."""
    return [
        {"wheel": 60},
        {"until": f"wheels.length >= {count}"},
        {"name": name, "script": POSE},
    ]


def wheels_and_keys() -> list[dict[str, Any]]:
    """Over the view, over the page around it, and while something is typed there."""
    return [
        *READY,
        {"hover": [200, 150]},
        {"name": "start", "script": POSE},
        *wheel("scrolled", 1),
        {"name": "_", "script": "document.querySelector('#name').focus({preventScroll: true})"},
        *[{"press": key} for key in ("f", "w", "?", "ArrowLeft")],
        {"name": "typed", "script": f"[document.querySelector('#name').value, {POSE}, {HELP}]"},
        {"name": "_", "script": "document.activeElement.blur()"},
        {"press": "f"},
        {"name": "over", "script": POSE},
        {"press": "ArrowDown"},
        {"hover": [600, 400]},
        {"press": "c"},
        {"name": "beside", "script": POSE},
        {"name": "_", "script": "viewer().focus()"},
        {"press": "ArrowLeft"},
        {"name": "_", "script": "scrollTo(0, 0)"},
        {"hover": [200, 150]},
        {"name": "focused", "script": POSE},
        *wheel("zoomed", 2),
        {"name": "_", "script": "viewer().blur()"},
        *wheel("left", 3),
        {"name": "touch", "script": TOUCH},
        {"name": "_", "script": "viewer().setAttribute('wheel', '')"},
        {"name": "asked touch", "script": TOUCH},
        {"name": "_", "script": "scrollTo(0, 0)"},
        *wheel("asked", 4),
        {"name": "wheels", "script": "wheels"},
        {"name": "keys", "script": "keys"},
    ]


def test_wheel_and_keys_are_left_to_the_page_around_it(small: Path, tmp_path: Path) -> None:
    steps = wheels_and_keys()
    with site(tmp_path, small) as address:
        found = visit(address, tmp_path, steps, (640, 480), init=NOTED).results
    pose = found["start"]
    assert found["wheels"] == [False, True, False, True], (
        "the page's, ours after a click, asked for"
    )
    assert found["scrolled"] == pose
    assert found["typed"] == ["fw?", pose, False], "what is typed elsewhere is not a key"
    assert found["over"] != pose, "with the pointer over it keys work without a click"
    assert found["beside"] == found["over"]
    typed = [[key, False] for key in ("f", "w", "?", "ArrowLeft")]
    assert found["keys"] == [
        *typed,
        ["f", True],
        ["ArrowDown", False],
        ["c", False],
        ["ArrowLeft", True],
    ]
    assert found["zoomed"] != found["focused"] and found["left"] == found["zoomed"]
    assert found["asked"] != found["left"]
    assert (found["touch"], found["asked touch"]) == ("pan-y", "none"), "a finger scrolls the page"


HEAR = """
globalThis.heard = [];
const note = (where) => (event) => heard.push(where + " " + event.type);
globalThis.addEventListener("DOMContentLoaded", () => {
  for (const name of ["header", "complete", "viewer-error", "error"]) {
    viewer().addEventListener(name, note("element"));
    document.querySelector("#around").addEventListener(name, note("around"));
    addEventListener(name, note("window"));
  }
  globalThis.onerror = () => { heard.push("onerror"); };
});"""


def test_events_bubble_and_trouble_is_no_error_of_the_page(small: Path, tmp_path: Path) -> None:
    script = (
        "new Promise((done) => { viewer().addEventListener('viewer-error', "
        "({ detail }) => setTimeout(() => done(detail), 100));"
        "viewer().setAttribute('src', 'missing.gsyn'); })"
    )
    steps = [*READY, {"name": "detail", "script": script}, {"name": "heard", "script": "heard"}]
    with site(tmp_path, small) as address:
        found = visit(address, tmp_path, steps, (640, 480), init=HEAR).results
    assert found["detail"]["message"] and found["detail"]["trouble"]
    heard = found["heard"]
    for name in ("header", "complete", "viewer-error"):
        assert [f"{at} {name}" for at in ("element", "around", "window")] == [
            text for text in heard if text.endswith(f" {name}")
        ], name
    assert not [text for text in heard if "onerror" in text or text.endswith(" error")]


def test_attributes_are_honoured_when_they_change(small: Path, tmp_path: Path) -> None:
    levels = decode(small.read_bytes(), "scene").levels
    most = "viewer().shadowRoot.querySelector('[aria-label=Level]').max"
    chosen = "viewer().shadowRoot.querySelector('[aria-label=Level]').ariaValueText"
    state = f"[viewer().scene.facts.most, {most}, {POSE}]"
    few = levels[1].live
    steps: list[dict[str, Any]] = [
        {"name": "_", "script": "viewer().camera = { position: [1, -2, -9], target: [0, 0, 0] }"},
        {"name": "start", "script": state},
        {"name": "_", "script": f"viewer().setAttribute('budget', '{few}')"},
        {"until": f"viewer().scene.facts.room === {few} && viewer().scene.drawn > 0"},
        {"name": "small", "script": state},
        {"name": "drawn", "script": "viewer().scene.settled().then(() => viewer().scene.drawn)"},
        {"name": "_", "script": "viewer().removeAttribute('budget')"},
        {"until": "viewer().scene.facts.room === Infinity"},
        {"name": "large", "script": state},
        {"name": "_", "script": "viewer().setAttribute('level', '1')"},
        {"name": "level", "script": chosen},
        {"name": "_", "script": "viewer().removeAttribute('level')"},
        {"name": "auto", "script": chosen},
        {"name": "_", "script": "viewer().setAttribute('live', '0.2')"},
        {"until": "heads > 2"},
        {"name": "_", "script": "viewer().removeAttribute('live')"},
        {"sleep": 300},
        {"name": "live", "script": "heads"},
        {"sleep": 700},
        {"name": "later", "script": "heads"},
    ]
    heads = (
        "globalThis.heads = 0; const usual = fetch; globalThis.fetch = (address, options) => {"
        "if (options?.method === 'HEAD') heads++; return usual(address, options); };"
    )
    with site(tmp_path, small) as address:
        found = visit(address, tmp_path, [*READY, *steps], (640, 480), init=heads).results
    pose = found["start"][2]
    assert found["start"][:2] == [3, "4"]
    assert found["small"] == [3, "4", pose], "the camera stays"
    assert 0 < found["drawn"] <= few
    assert found["large"] == [3, "4", pose]
    assert (found["level"], found["auto"]) == ("L1", "auto")
    assert found["later"] == found["live"], "it looks for newer versions no more"


def test_the_camera_is_read_set_and_told(small: Path, tmp_path: Path) -> None:
    steps: list[dict[str, Any]] = [
        {"name": "first", "script": "viewer().camera"},
        {"name": "_", "script": "viewer().camera = { position: [1, -2, -9], target: [0.5, 0, 1] }"},
        {"name": "there", "script": "viewer().camera"},
        {"name": "w2c", "script": "viewer().scene.pinhole().w2c"},
        {
            "name": "same",
            "script": "(({position, quaternion, target}) => { viewer().first();"
            "viewer().camera = {position, quaternion, target}; return viewer().camera; })"
            "(viewer().camera)",
        },
        {"name": "fov", "script": "((viewer().camera = { fov: 1 }), viewer().camera)"},
        {
            "name": "refused",
            "script": "[{fov: 4}, {position: [1, NaN, 0]}, {quaternion: [0, 0, 0, 0]},"
            "{position: [1, 1, 1], target: [1, 1, 1]}].map((wanted) => { try {"
            "viewer().camera = wanted; return 'taken'; } catch (error) { return error.name; } })",
        },
        {"name": "kept", "script": "viewer().camera"},
        {
            "name": "told",
            "script": "new Promise((done) => { const told = []; let k = 0;"
            "viewer().addEventListener('camera-change', ({ detail }) => "
            "told.push({ ...detail, at: performance.now() }));"
            "const turn = () => { viewer().scene.camera.orbit(0.01, 0); viewer().scene.move();"
            "k++ < 40 ? setTimeout(turn, 10)"
            " : setTimeout(() => done([told, viewer().camera]), 400); };"
            "turn(); })",
        },
    ]
    found = tour(small, tmp_path, steps).results
    there = found["there"]
    assert there["position"] == [1, -2, -9]
    assert there["target"] == pytest.approx([0.5, 0, 1])
    world_camera = rotation(there["quaternion"])
    assert np.allclose(world_camera.T, np.reshape(found["w2c"], (3, 4))[:, :3], atol=1e-9)
    for name in ("position", "target", "quaternion"):
        assert found["same"][name] == pytest.approx(there[name])
    assert found["fov"]["fov"] == 1 and found["first"]["fov"] == there["fov"] != 1
    assert found["refused"] == ["RangeError"] * 4
    assert found["kept"] == found["fov"], "nothing of a camera that was refused stays"
    told, last = found["told"]
    times = [state.pop("at") for state in told]
    assert len(told) > 1 and (times[-1] - times[0]) / (len(times) - 1) > 99
    assert told[-1] == last, "where it came to rest is told too"


def rotation(quaternion: list[float]) -> np.ndarray:
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_methods_do_what_the_buttons_do(bright: Path, tmp_path: Path) -> None:
    picture = (
        "viewer().picture().then(async (blob) => [blob.type, viewer().shadowRoot.querySelector("
        "'canvas').width, bytes(new Uint8Array(await blob.arrayBuffer()))])"
    )
    steps: list[dict[str, Any]] = [
        {"name": "start", "script": POSE},
        {"name": "whole", "script": f"(viewer().whole(), {POSE})"},
        {"name": "next", "script": f"(viewer().next(), {POSE})"},
        {"name": "back", "script": f"(viewer().next(-1), {POSE})"},
        {"name": "_", "script": "viewer().next(3)"},
        {"name": "first", "script": f"(viewer().first(), {POSE})"},
        {"name": "levels", "script": "viewer().levels"},
        {"name": "stats", "script": "viewer().stats"},
        {"name": "_", "script": "viewer().scene.settled()"},
        {"name": "picture", "script": picture},
    ]
    found = tour(bright, tmp_path, steps).results
    assert found["first"] == found["back"] == found["start"]
    assert len({found["start"], found["whole"], found["next"]}) == 3
    levels = decode(bright.read_bytes(), "scene").levels
    assert [level["anchors"] for level in found["levels"]] == [level.anchors for level in levels]
    assert all(level["ready"] for level in found["levels"])
    assert found["levels"][-1]["bytes"] == bright.stat().st_size == found["stats"]["total"]
    assert found["stats"]["splats"] > 0 and 0 <= found["stats"]["fps"] <= 240
    kind, width, data = found["picture"]
    image = Image.open(io.BytesIO(base64.b64decode(data)))
    assert kind == "image/png" and image.size == (width, width * 3 // 4)
    assert np.asarray(image.convert("RGB"), np.float64).std() > 10, "the picture is blank"
