"""What two levels have to do with each other on the page: the split view, and the cross-fade."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.viewer.browser import MISSING, SIZE, pages, pinhole, pixels, psnr, visit
from gsynopsis.container import decode
from tests.viewer.bright import LEAST_DB, camera_of, drawn_by_cpu
from tests.viewer.resting import at_pace

pytestmark = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"
)
Picture = NDArray[np.float64]
SPLIT = "viewer().shadowRoot.querySelector('.divider')"
SHARE = f"Number({SPLIT}.getAttribute('aria-valuenow'))"
HELD = "({textures: viewer().scene.renderer.bytes, memory: viewer().scene.memory})"


def joined(left: Picture, right: Picture, share: float) -> Picture:
    """The left part of one picture beside the right part of another."""
    at = round(share * left.shape[1])
    return np.concatenate([left[:, :at], right[:, at:]], axis=1)


def test_the_split_view_shows_two_levels_side_by_side(bright: Path, tmp_path: Path) -> None:
    levels = decode(bright.read_bytes(), "scene")
    camera = camera_of(levels)
    look = f"picture({pinhole(camera)}, null)"
    middle, right = [SIZE[0] // 2, 20], [SIZE[0] * 3 // 4, 25]
    steps: list[dict[str, Any]] = [
        {"wait": "complete"},
        {"name": "start", "script": look},
        {"drag": [middle, right]},
        {"name": "dragged share", "script": SHARE},
        {"name": "dragged", "script": look},
        {"name": "_", "script": f"{SPLIT}.focus()"},
        {"press": "Home"},
        {"press": "Shift+ArrowRight"},
        {"press": "ArrowRight"},
        {"press": "ArrowRight"},
        {"press": "ArrowLeft"},
        {"name": "pressed share", "script": SHARE},
        {"name": "pressed", "script": look},
        {"name": "role", "script": f"{SPLIT}.getAttribute('role')"},
        {"name": "held", "script": HELD},
        {"name": "_", "script": "viewer().shadowRoot.querySelector('.stage').focus()"},
        {"press": "KeyC"},
        {"name": "closed", "script": look},
        {"name": "hidden", "script": f"{SPLIT}.hidden"},
        {"name": "given back", "script": HELD},
    ]
    with pages(bright) as address:
        found = visit(f"{address}/?noui&level=3&split=0", tmp_path, steps).results
    pictures = drawn_by_cpu(levels, camera)
    assert found["role"] == "separator"
    for name, share in (
        ("start", 0.5),
        ("dragged", found["dragged share"] / 100),
        ("pressed", found["pressed share"] / 100),
    ):
        drawn = pixels(found[name])
        assert psnr(drawn, joined(pictures[0], pictures[3], share)) >= LEAST_DB, name
        assert psnr(drawn, pictures[3]) < LEAST_DB - 3, name
    assert (found["dragged share"], found["pressed share"]) == (75, 12)
    assert found["hidden"] is True
    assert psnr(pixels(found["closed"]), pictures[3]) >= LEAST_DB
    before, after = found["held"], found["given back"]
    assert after["textures"] < before["textures"]
    assert after["memory"]["decoded"] < before["memory"]["decoded"]


def test_the_split_view_is_chosen_by_button_and_slider(bright: Path, tmp_path: Path) -> None:
    root = "viewer().shadowRoot"
    slider = f"{root}.querySelectorAll('input[type=range]')"
    chosen = (
        f"(({slider}[0].value = 1), {slider}[0].dispatchEvent(new Event('input')),"
        f"({slider}[1].value = 2), {slider}[1].dispatchEvent(new Event('input')), 0)"
    )
    words = f"[{SPLIT}.dataset.left, {SPLIT}.dataset.right]"
    button = f"{root}.querySelector('[aria-label^=Compare]')"
    levels = decode(bright.read_bytes(), "scene")
    camera = camera_of(levels)
    steps: list[dict[str, Any]] = [
        {"wait": "complete"},
        {"name": "off", "script": f"[{button}.ariaPressed, {slider}[0].checkVisibility()]"},
        {"name": "_", "script": f"{button}.click()"},
        {"name": "on", "script": f"[{button}.ariaPressed, {slider}[0].checkVisibility()]"},
        {"name": "default", "script": words},
        {"name": "_", "script": chosen},
        {"name": "words", "script": words},
        {"name": "picture", "script": f"picture({pinhole(camera)}, null)"},
    ]
    with pages(bright) as address:
        found = visit(address, tmp_path, steps).results
    assert found["off"] == ["false", False]
    assert found["on"] == ["true", True]
    assert found["default"] == ["L0", "auto"]
    assert found["words"] == ["L1", "L2"]
    pictures = drawn_by_cpu(levels, camera)
    assert psnr(pixels(found["picture"]), joined(pictures[1], pictures[2], 0.5)) >= LEAST_DB


AT_TIMES = """
globalThis.clock = 100;
globalThis.over = () => {
  const { panes: [pane], renderer } = viewer().scene;
  return pane.isSettled(clock) && !renderer.layer(0).changing;
};
globalThis.turn = async (level, shares) => {
  const { scene } = viewer();
  scene.seconds = () => clock;
  scene.setLevel(level);
  const { serial } = scene;
  const there = () => scene.panes[0].shown >= serial && scene.panes[0].isSettled(1e9);
  while (!there()) await new Promise((again) => setTimeout(again, 20));
  const begun = clock;
  const found = [];
  for (const share of shares) {
    clock = begun + share * scene.renderer.fade;
    const { width, height, pixels } = scene.capture(true);
    found.push({ width, height, pixels: bytes(pixels), textures: scene.renderer.bytes });
  }
  return found;
};
"""


def test_looks_of_levels_fade_into_each_other(bright: Path, tmp_path: Path) -> None:
    levels = decode(bright.read_bytes(), "scene")
    camera = camera_of(levels)
    shares = [0, 0.25, 0.5, 0.75, 0.999]
    steps: list[dict[str, Any]] = [
        {"wait": "complete"},
        {"name": "held", "script": f"picture({pinhole(camera)}, 3).then(() => {HELD})"},
        {"name": "_", "script": f"viewer().scene.setPinhole({pinhole(camera)})"},
        {"name": "_", "script": "viewer().scene.settled()"},
        at_pace(16),
        {"name": "down", "script": f"turn(0, {shares})"},
        {"name": "_", "script": "clock += 1"},
        {"until": "over()"},
        {"name": "half up", "script": "turn(3, [0, 0.5])"},
        # The next change begins in the middle of this one.
        {"name": "down again", "script": "turn(0, [0, 0.5, 1])"},
        {"name": "_", "script": "clock += 1"},
        {"until": "over()"},
        {"name": "end", "script": "turn(2, [0.5])"},
        {"name": "_", "script": "clock += 1"},
        {"until": "over()"},
        {"name": "after", "script": HELD},
    ]
    with pages(bright) as address:
        found = visit(f"{address}/?noui&level=3", tmp_path, steps, init=AT_TIMES).results
    coarse, *_, fine = drawn_by_cpu(levels, camera)
    down = [pixels(picture) for picture in found["down"]]
    assert psnr(down[0], fine) >= LEAST_DB
    assert psnr(down[-1], coarse) >= LEAST_DB
    errors = [(float(abs(p - fine).mean()), float(abs(p - coarse).mean())) for p in down]
    whole = float(abs(fine - coarse).mean())
    for (away, to), (later_away, later_to) in pairwise(errors):
        assert away < later_away and to > later_to, "each moment is nearer to the new level"
        assert later_away - away < 0.6 * whole, "nothing pops"
    half, again = pixels(found["half up"][1]), [pixels(p) for p in found["down again"]]
    assert psnr(half, fine) < 35 and psnr(half, coarse) < 35
    assert psnr(again[0], half) >= 45, "a change that is overtaken goes on from where it was"
    assert psnr(again[2], coarse) >= LEAST_DB
    assert found["down"][2]["textures"] > found["held"]["textures"]
    assert found["after"]["textures"] == found["held"]["textures"], "memory of a change is kept"
