"""What a visitor meets: hint, bar, keys and trackpads, looks, notes, many scenes on a page."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.viewer.browser import MISSING, pages, screenshot, visit
from gsynopsis.container import annotated
from gsynopsis.container.annotate import annotations_of
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.page import FOLDER
from gsynopsis.serve.run import serving
from tests.viewer.element_site import site
from tests.viewer.room import FLOOR, PILLAR

pytestmark = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"
)
ROOT = "viewer().shadowRoot"
READY: list[dict[str, Any]] = [{"wait": "complete"}, {"until": f"!!{ROOT}.querySelector('.bar')"}]
OPACITY = f"getComputedStyle({ROOT}.querySelector('.dock')).opacity"
HINT = f"{ROOT}.querySelector('.hint')?.checkVisibility() ?? false"
DRAG = {"drag": [[300, 100], [320, 110]]}
KEY = {"press": "?"}
CLICK = {"name": "clicked", "script": f"{ROOT}.querySelector('[aria-keyshortcuts=Home]').click()"}
POSE = "viewer().camera.position.map((v) => v.toFixed(5)).join()"
INSIDE = "(viewer().camera = { position: [0, 0.2, -1.5], target: [0, 0.2, 1.0] }, 0)"
ZOOM = (
    f"(() => {{ const stage = {ROOT}.querySelector('.stage'); for (let i = 0; i < 80; i++)"
    " stage.dispatchEvent(new WheelEvent('wheel', { deltaY: -100, ctrlKey: true, bubbles: true,"
    " cancelable: true })); return viewer().camera; })()"
)


@pytest.mark.parametrize("touch", [DRAG, CLICK, KEY], ids=["drag", "no pointer", "no focus"])
def test_the_hint_goes_with_the_first_touch_and_the_bar_fades(
    touch: dict[str, Any], small: Path, tmp_path: Path
) -> None:
    width = f"{ROOT}.querySelector('.bar').offsetWidth"
    steps: list[dict[str, Any]] = [
        *READY,
        {"until": HINT},
        {"until": f"{OPACITY} === '0'"},
        {"hover": [300, 100]},
        {"until": f"{OPACITY} === '1'"},
        {"name": "width", "script": width},
        {"name": "still", "script": HINT},
        touch,
        {"name": "after", "script": HINT},
        {"name": "title", "script": f"{ROOT}.querySelector('[aria-keyshortcuts=Home]').ariaLabel"},
    ]
    with pages(small) as address:
        found = visit(address, tmp_path, steps, (600, 338), context={"locale": "fr-CA"}).results
    assert found["width"] <= 200, "at most a third of an embed"
    assert found["still"] and not found["after"]
    assert found["title"] == "Première vue"


def test_meta_walks_nowhere_a_pinch_is_quick_and_a_drag_leaves_no_frame(
    small: Path, tmp_path: Path
) -> None:
    far = "viewer().scene.camera.pose.distance"
    frame = f"getComputedStyle({ROOT}.querySelector('.stage'), '::after').content"
    steps: list[dict[str, Any]] = [
        *READY,
        {"press": "Tab"},
        {"name": "frame", "script": frame},
        {"drag": [[60, 60], [70, 60]]},
        {"name": "dragged", "script": frame},
        {"name": "start", "script": POSE},
        {"down": "Meta"},
        {"press": "w", "delay": 150},
        {"up": "Meta"},
        {"sleep": 100},
        {"name": "meta", "script": POSE},
        {"down": "w"},
        {"until": "viewer().scene.mover?.active"},
        {"down": "Meta"},
        {"name": "halted", "script": "viewer().scene.mover.active"},
        {"up": "Meta"},
        {"up": "w"},
        {"name": "far", "script": far},
        {"pinch": -10},
        {"sleep": 200},
        {"name": "near", "script": far},
    ]
    with pages(small) as address:
        found = visit(f"{address}/?noui&free", tmp_path, steps).results
    assert (found["frame"], found["dragged"]) == ('""', "none")
    assert found["meta"] == found["start"]
    assert found["halted"] is False, "the key is let go, of which systems do not tell then"
    assert found["near"] / found["far"] == pytest.approx(np.exp(-0.1), rel=1e-3)


def test_looks_zooms_and_f_know_what_is_solid(room: Path, tmp_path: Path) -> None:
    pick = "viewer().equip().then(({ places }) => places.pick(0.5, 0.5))"
    steps: list[dict[str, Any]] = [
        *READY,
        {"name": "_", "script": INSIDE},
        {"name": "pillar", "script": pick},
        {"name": "zoomed", "script": ZOOM},
        {"name": "_", "script": "(viewer().camera = { position: [0, 0.2, -1.5],"
         " target: [0, 0.2, 20] }, 0)"},
        {"name": "far", "script": ZOOM},
        {"name": "_", "script": INSIDE},
        {"doubleClick": [120, 150]},
        {"until": "!viewer().scene.mover.active"},
        {"name": "looked", "script": "viewer().camera"},
        {"press": "f"},
        {"name": "whole", "script": "viewer().camera"},
    ]  # fmt: skip
    with pages(room) as address:
        found = visit(f"{address}/?noui", tmp_path, steps, (240, 160)).results
    assert found["pillar"] == pytest.approx([0, 0.2, PILLAR[0]], abs=0.05)
    assert found["zoomed"]["position"][2] < 1.0, "its own pivot is before the pillar"
    assert 1.0 < found["far"]["position"][2] < PILLAR[0], "the pivot is behind, the wall holds"
    assert found["looked"]["position"] == pytest.approx([0, 0.2, -1.5])
    assert found["looked"]["target"][1] == pytest.approx(FLOOR, abs=0.1), "the floor"
    assert found["whole"]["target"] == pytest.approx([0, 0.5, 0], abs=0.8)


def test_notes_are_shown_toured_made_and_saved(room: Path, tmp_path: Path) -> None:
    camera = {"position": [0, 0, -2.0], "target": [0, 0, 0], "quaternion": [1, 0, 0, 0]}
    notes = [
        {"title": "A <b>wall", "text": "Green", "at": [0.8, 0.2, 2.98], "camera": camera},
        {"title": "Pillar", "text": "", "at": [0, 0.2, PILLAR[0]],
         "camera": {**camera, "position": [0, 0, -1.0]}},
    ]  # fmt: skip
    file = tmp_path / "scene.gsyn"
    text = json.dumps(notes)
    file.write_bytes(annotated(room.read_bytes(), {"annotations": text}, None, "room"))
    dots = f"[...{ROOT}.querySelectorAll('.dot')]"
    card = f"{ROOT}.querySelector('.card')"
    steps: list[dict[str, Any]] = [
        *READY,
        {"name": "_", "script": INSIDE},
        {"until": f"{dots}[0].style.visibility === 'visible'"},
        {
            "name": "place",
            "script": "viewer().scene.settled().then(() => { const box ="
            f" {dots}[1].getBoundingClientRect(); return [box.x + box.width / 2,"
            " box.y + box.height / 2]; })",
        },
        {"press": "n"},
        {"name": "first", "script": f"{card}.innerText"},
        {"press": "n"},
        {"until": "!viewer().scene.mover.active"},
        {"name": "second", "script": f"[{card}.innerText, viewer().camera.position]"},
        {"press": "Escape"},
        {"name": "closed", "script": f"{card}.checkVisibility()"},
        {"hover": [120, 80]},
        {"press": "m"},
        *[{"press": key} for key in ("N", "e", "w")],
        {
            "name": "_",
            "script": f"[...{card}.querySelectorAll('footer button')].at(-1).click()",
        },
        {"until": f"{ROOT}.querySelector('.note').innerText !== ''"},
        {"name": "told", "script": f"{ROOT}.querySelector('.note').innerText"},
        {"name": "count", "script": f"{dots}.length"},
    ]
    app = make_app(root_of(file), viewer=FOLDER, edit=True)
    with serving(app) as address:
        found = visit(address, tmp_path, steps, (240, 160)).results
    assert found["place"] == pytest.approx([120, 80], abs=12)
    assert "A <b>wall" in found["first"] and "1 / 2" in found["first"]
    assert "Pillar" in found["second"][0] and found["second"][1] == pytest.approx([0, 0, -1.0])
    assert found["closed"] is False
    assert found["told"] == "Saved in the file." and found["count"] == 3
    saved = json.loads(annotations_of(file))
    assert saved[:2] == notes and saved[2]["title"] == "New"
    assert saved[2]["at"][2] == pytest.approx(PILLAR[0], abs=0.1)


def test_twenty_scenes_on_a_page_share_six_devices(small: Path, tmp_path: Path) -> None:
    one = '<gsynopsis-viewer noui src="scene.gsyn"></gsynopsis-viewer>'
    page = (
        "<!doctype html><style>body { margin: 0; line-height: 0 }"
        " gsynopsis-viewer { display: inline-block; width: 120px; height: 80px }</style>"
        f'<script type="module" src="gsynopsis-viewer.js"></script>{one * 20}'
    )
    hear = (
        "globalThis.whole = new Set(); globalThis.notices = [];"
        "addEventListener('complete', ({ target }) => whole.add(target));"
        "addEventListener('viewer-notice', ({ detail }) => notices.push(detail.message));"
    )
    all_ = "[...document.querySelectorAll('gsynopsis-viewer')]"
    steps: list[dict[str, Any]] = [
        {"until": "whole.size === 20", "timeout": 120000},
        {"until": f"{all_}.filter(({{ scene }}) => scene?.resting && scene.lost).length === 14"},
        {"sleep": 500},
        {"name": "resting", "script": f"{all_}.filter(({{ scene }}) => scene.resting).length"},
        {"shot": "all"},
        {"name": "_", "script": f"{all_}.forEach((each, k) => k && each.blur())"},
        {"hover": [60, 40]},
        {"until": f"!{all_}[0].scene.resting && !{all_}[0].scene.lost"},
        {"name": "notices", "script": "notices.filter(Boolean)"},
    ]
    with site(tmp_path, small, page) as address:
        found = visit(address, tmp_path, steps, (600, 320), init=hear)
    assert found.results["resting"] == 14 and not found.results["notices"]
    image = screenshot(tmp_path / "all.png")
    parts = [
        image[80 * y : 80 * y + 80, 120 * x : 120 * x + 120] for y in range(4) for x in range(5)
    ]
    assert min(float(part.std()) for part in parts) > 0.05, "one of them is blank"
