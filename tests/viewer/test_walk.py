"""On foot: at the height of the eyes, around walls; notes behind them; fields of view."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.viewer.browser import MISSING, pages, visit
from gsynopsis.container import annotated
from tests.viewer.room import FLOOR, HALF, PILLAR

pytestmark = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"
)
ROOT = "viewer().shadowRoot"
READY: list[dict[str, Any]] = [{"wait": "complete"}, {"until": f"!!{ROOT}.querySelector('.bar')"}]
PLACE = "viewer().camera.position"
WALKS = f"{ROOT}.querySelector('[aria-keyshortcuts=G]').ariaPressed"
LOG = (
    "globalThis.way = []; addEventListener('camera-change',"
    " ({ detail }) => way.push(detail.position));"
)
REST = "!viewer().scene.mover?.active"
TALL = 1.0
SIDE = 0.69946
"""Half of the longer side of the lens where no photo says otherwise, at a depth of 1."""


def look(position: list[float], target: list[float]) -> dict[str, Any]:
    pose = json.dumps({"position": position, "target": target})
    return {"name": "_", "script": f"(viewer().camera = {pose}, 0)"}


def test_a_walk_goes_around_what_is_solid_and_keeps_its_height(room: Path, tmp_path: Path) -> None:
    eyes = FLOOR - TALL
    steps: list[dict[str, Any]] = [
        *READY,
        look([0, eyes, -1.5], [0, eyes, 1.0]),
        {"press": "g"},
        {"name": "pressed", "script": WALKS},
        look([0, eyes, 0.5], [0, eyes, 1.0]),
        {"down": "w"},
        {"sleep": 2500},
        {"up": "w"},
        {"name": "halted", "script": PLACE},
        look([0.3, eyes - 0.4, -1.5], [0.3, eyes - 0.2, 1.0]),
        {"sleep": 200},
        {"name": "_", "script": "(way.length = 0, 0)"},
        {"down": "w"},
        {"until": f"{PLACE}[2] > {HALF - 0.5}", "timeout": 90000},
        {"sleep": 1500},
        {"up": "w"},
        {"until": REST},
        {"name": "end", "script": PLACE},
        {"name": "way", "script": "way"},
        look([0, eyes, -1.5], [0, eyes, 1.0]),
        {"name": "before", "script": "viewer().camera"},
        {"drag": [[120, 40], [160, 40]]},
        {"name": "after", "script": "viewer().camera"},
        look([0, eyes, -1.5], [0, eyes + 0.6, 0]),
        {"sleep": 300},
        {"doubleClick": [120, 80]},
        {"until": REST},
        {"name": "there", "script": PLACE},
        {"press": "Escape"},
        {"name": "ended", "script": f"[{WALKS}, viewer().scene.camera.onFoot]"},
    ]
    with pages(room) as address:
        found = visit(f"{address}/?free", tmp_path, steps, (240, 160), init=LOG).results
    assert found["pressed"] == "true"
    assert PILLAR[0] - 0.5 < found["halted"][2] < PILLAR[0] - 0.1, "the pillar is before it"
    way = np.array(found["way"])
    assert len(way) > 5 and way[0, 2] < 0
    across = np.interp(PILLAR[0], way[:, 2], way[:, 0])
    assert abs(across) > PILLAR[1], "it went through the pillar"
    assert HALF - 0.6 < found["end"][2] < HALF - 0.15 * TALL, "the wall ends it"
    assert found["end"][1] == pytest.approx(eyes, abs=0.05), "back at the height of the eyes"
    assert found["before"]["position"] == pytest.approx(found["after"]["position"])
    turned = np.abs(np.subtract(found["before"]["target"], found["after"]["target"])).max()
    assert turned > 0.3, "a drag turns the head"
    assert found["there"][1] == pytest.approx(eyes, abs=0.1)
    assert -1.4 < found["there"][2] < PILLAR[0], "it went to the ground that was clicked"
    assert found["ended"] == ["false", False]


def test_nobody_walks_where_there_is_no_ground(room: Path, tmp_path: Path) -> None:
    steps: list[dict[str, Any]] = [
        *READY,
        look([0, FLOOR + 1, 0], [0, FLOOR + 1, 1]),
        {"press": "g"},
        {"name": "walks", "script": WALKS},
        {"name": "told", "script": f"{ROOT}.querySelector('.note').innerText"},
    ]
    with pages(room) as address:
        found = visit(f"{address}/?free", tmp_path, steps, (240, 160)).results
    assert found["walks"] == "false" and "no ground" in found["told"]


def test_notes_behind_something_fade(room: Path, tmp_path: Path) -> None:
    camera = {"position": [0, 0, -2.0], "target": [0, 0, 0], "quaternion": [1, 0, 0, 0]}
    notes = [
        {"title": "Pillar", "text": "", "at": [0, 0.2, PILLAR[0]], "camera": camera},
        {"title": "Wall", "text": "", "at": [0, 0.2, HALF], "camera": camera},
    ]
    file = tmp_path / "scene.gsyn"
    text = {"annotations": json.dumps(notes)}
    file.write_bytes(annotated(room.read_bytes(), text, None, "room"))
    dots = f"[...{ROOT}.querySelectorAll('.dot')]"
    opacity = f"{dots}.map((dot) => getComputedStyle(dot).opacity)"
    # Once they have faded, however long ago they were somewhere else.
    behind = (
        f"{dots}.map((dot) => dot.classList.contains('behind')).join() === {{}}"
        f" && {dots}.every((dot) => !dot.getAnimations().length)"
    )
    steps: list[dict[str, Any]] = [
        *READY,
        look([0, 0.2, -1.5], [0, 0.2, 1.0]),
        {"until": behind.format("'false,true'")},
        {"name": "front", "script": opacity},
        look([2.0, 0.2, -1.5], [0, 0.2, 2.0]),
        {"until": behind.format("'false,false'")},
        {"name": "aside", "script": opacity},
        look([1.0, 0.2, 2.6], [0, 0.2, 1.6]),
        {"sleep": 800},
        {"name": "back", "script": opacity},
        look([0, 0.2, 2.6], [0, 0.2, 0.0]),
        {"sleep": 800},
        {"name": "near", "script": opacity},
        look([0, FLOOR + 2, 1.5], [0, 0, 1.6]),
        {"until": f"{dots}.every((dot) => dot.classList.contains('behind'))"},
    ]
    with pages(file) as address:
        found = visit(f"{address}/?free", tmp_path, steps, (240, 160)).results
    assert found["front"] == ["1", "0.25"]
    assert found["aside"] == ["1", "1"]
    assert found["back"][0] == "1", "seen from behind, a thin pillar hides no note on it"
    assert found["near"][0] == "1"


def test_a_phone_shows_as_much_along_its_longer_side_whichever_way_it_is_held(
    small: Path, tmp_path: Path
) -> None:
    fov = "viewer().camera.fov"
    sizes = [(390, 844), (844, 390), (600, 450)]
    steps: list[dict[str, Any]] = [*READY]
    for size in sizes:
        there = f"viewer().clientWidth === {size[0]} && viewer().scene.canvas.width === {size[0]}"
        steps += [
            {"size": size},
            {"until": there},
            {"sleep": 500},
            {"name": str(size), "script": fov},
        ]
    found = {}
    with pages(small) as address:
        for touch in (False, True):
            context = {"hasTouch": touch, "isMobile": touch}
            found[touch] = visit(address, tmp_path, steps, sizes[0], context=context).results
    for size in sizes:
        ratio = max(size) / min(size)
        assert np.tan(found[True][str(size)] / 2) * ratio == pytest.approx(SIDE, rel=1e-2)
        assert np.tan(found[False][str(size)] / 2) ** 2 * ratio == pytest.approx(
            SIDE * 0.46631, rel=1e-2
        )
