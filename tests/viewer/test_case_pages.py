"""Pages of the shared cases: twenty scenes, a scene opened early, a strict policy."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.viewer.browser import MISSING, screenshot, visit
from tests.viewer.element_site import site

CASES = Path(__file__).parents[3] / "shared" / "cases" / "splats" / "viewer_pages"
pytestmark = [
    pytest.mark.skipif(bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"),
    pytest.mark.skipif(not CASES.is_dir(), reason=f"{CASES} is not there: its pages NOT tried"),
]
ALL = "[...document.querySelectorAll('gsynopsis-viewer')]"
BOXES = (
    f"{ALL}.map((each) => each.getBoundingClientRect())"
    ".map(({ left, top, width, height }) => [left, top, width, height].map(Math.round))"
)
HEAR = (
    "globalThis.whole = new Set(); globalThis.told = [];"
    "addEventListener('complete', ({ target }) => whole.add(target));"
    "for (const name of ['viewer-error', 'viewer-notice'])"
    " addEventListener(name, ({ detail }) => told.push(detail.message));"
)


def page(name: str) -> str:
    """A page of the cases, beside our scene in place of theirs."""
    return (CASES / f"{name}.html").read_text(encoding="utf-8").replace("demo.gsyn", "scene.gsyn")


def test_all_of_twenty_scenes_show_a_picture(bright: Path, tmp_path: Path) -> None:
    steps: list[dict[str, Any]] = [
        {"until": "whole.size === 20", "timeout": 120_000},
        {"until": f"{ALL}.filter(({{ scene }}) => scene?.resting && scene.lost).length === 14"},
        {"sleep": 500},
        {"name": "boxes", "script": BOXES},
        {"name": "told", "script": "told.filter(Boolean)"},
        {"shot": "many"},
    ]
    with site(tmp_path, bright, page("many")) as address:
        found = visit(address, tmp_path, steps, (1100, 700), init=HEAR).results
    assert not found["told"] and len(found["boxes"]) == 20
    image = screenshot(tmp_path / "many.png")
    for left, top, width, height in found["boxes"]:
        # Above the bar, which is not the scene.
        part = image[top + 5 : top + height // 2, left + 5 : left + width - 5]
        assert float(np.std(part)) > 0.05, (left, top)


@pytest.mark.parametrize("name", ["open_first", "strict"])
def test_the_scene_is_shown(name: str, bright: Path, tmp_path: Path) -> None:
    """Opened before it is in the page, and under a policy that allows no workers of blobs."""
    ended = "whole.size === 1 || told.some(Boolean)"
    steps: list[dict[str, Any]] = [
        {"until": ended, "timeout": 60_000},
        {"sleep": 300},
        {"name": "told", "script": "told.filter(Boolean)"},
        {"name": "drawn", "script": "viewer().scene?.drawn ?? 0"},
    ]
    with site(tmp_path, bright, page(name)) as address:
        found = visit(address, tmp_path, steps, (600, 400), init=HEAR).results
    assert found["drawn"] > 0 or "worker-src" in " ".join(found["told"])
    assert name == "strict" or not found["told"]
