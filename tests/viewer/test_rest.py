"""The picture while nobody moves the camera: what is asked for meanwhile is drawn whole."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks.viewer.browser import MISSING, SIZE, pages, pixels, psnr, visit
from gsynopsis.container import encode
from gsynopsis.container.writer import encode_with_account
from tests.level_sets import PLAIN_SPLATS
from tests.viewer.bright import bright_levels
from tests.viewer.resting import AT_REST, READY, at_pace
from tests.viewer.test_bounded import QUIET, wide
from tests.viewer.test_bounded import SHARE as BUDGET_SHARE
from tests.viewer.test_sides import SHARE, joined
from tests.viewer.test_splats import bright_splats
from tests.viewer.test_supersampling import PICTURE, trained_at

pytestmark = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"
)
SAME_DB = 45.0
"""One renderer draws both; what is left is the rounding of a canvas."""
FOUR = range(4)


def anchors(folder: Path) -> tuple[Path, str]:
    path = folder / "anchors.gsyn"
    path.write_bytes(encode(bright_levels(), "compact"))
    return path, ""


def anchors_in_blocks(folder: Path) -> tuple[Path, str]:
    path = folder / "blocks.gsyn"
    path.write_bytes(encode_with_account(bright_levels(), "compact", "scene", 128)[0])
    return path, ""


def splats_in_blocks(folder: Path) -> tuple[Path, str]:
    path = folder / "splats.gsyn"
    path.write_bytes(encode_with_account(bright_splats(), "compact", "scene", 32)[0])
    return path, ""


def more_than_the_budget(folder: Path) -> tuple[Path, str]:
    path, splats = wide(PLAIN_SPLATS, folder)
    return path, f"&budget={round(BUDGET_SHARE * splats)}"


def smaller_than_the_photos(folder: Path) -> tuple[Path, str]:
    """What stands still is drawn twice as large, and reduced."""
    path = folder / "small.gsyn"
    path.write_bytes(encode(trained_at(2.0), "raw"))
    return path, ""


@pytest.mark.parametrize(
    "scene",
    [anchors, anchors_in_blocks, splats_in_blocks, more_than_the_budget, smaller_than_the_photos],
)
def test_each_side_shows_its_level_though_nobody_moves(
    scene: Callable[[Path], tuple[Path, str]], tmp_path: Path
) -> None:
    """From aside: a split is switched on, moved, changed at either side, off and on again."""
    path, query = scene(tmp_path)
    middle, right = [SIZE[0] // 2, 20], [SIZE[0] * 3 // 4, 25]
    steps = READY.copy()
    states: dict[str, tuple[int | None, int, float]] = {}

    def rest(name: str, side: int | None, shown: tuple[int | None, int, float]) -> None:
        steps.append({"name": name, "script": f"atRest({json.dumps(side)})"})
        states[name] = shown

    def set_to(name: str, value: int) -> None:
        steps.append({"name": "_", "script": f"viewer().setAttribute('{name}', '{value}')"})

    steps.append({"name": "_", "script": "viewer().next(3)"})
    # Blocks beside those in the budget come for this view too, and no serial tells their end.
    steps.append({"name": "_", "script": f"(async () => {{ {QUIET} }})()"})
    rest("alone", 0, (None, 3, 0.5))
    steps.append({"press": "KeyC"})
    rest("compared", 1, (0, 3, 0.5))
    steps.append({"drag": [middle, right]})
    rest("moved", None, (0, 3, 0.75))
    set_to("split", 2)
    rest("left changed", 1, (2, 3, 0.75))
    set_to("level", 1)
    rest("right changed", 0, (2, 1, 0.75))
    steps.append({"press": "KeyC"})
    rest("off", None, (None, 1, 0.75))
    steps.append({"press": "KeyC"})
    rest("on again", 1, (2, 1, 0.75))
    steps += [{"name": "moved to", "script": SHARE}, {"press": "KeyC"}]
    for k in FOUR:
        shown = f"(viewer().scene.setLevel({k}), viewer().scene.settled()).then(() => {PICTURE})"
        steps.append({"name": f"{k}", "script": shown})
    with pages(path) as address:
        found = visit(f"{address}/?noui&keys&level=3{query}", tmp_path, steps, init=AT_REST).results
    assert found["moved to"] == 75
    whole = [pixels(found[f"{k}"]) for k in FOUR]
    assert all(psnr(whole[k], whole[3]) < SAME_DB - 10 for k in FOUR[:-1])
    decibels = {}
    for name, (left, level, share) in states.items():
        expected = whole[level] if left is None else joined(whole[left], whole[level], share)
        decibels[name] = psnr(pixels(found[name]), expected)
    assert min(decibels.values()) >= SAME_DB, decibels


SLOW = """(({ scene } = viewer()) => {
  const { renderer } = scene;
  const draw = renderer.draw.bind(renderer);
  renderer.draw = (frame) => {
    draw(frame);
    const [pane] = scene.panes;
    if (pane.sorting || !pane.isFading(frame.time)) return;
    while (pane.isFading(scene.seconds())) { /* the device is slow */ }
  };
  scene.picture.keptAt = -1e6;
})()"""


def test_a_change_of_level_ends_where_a_frame_takes_longer_than_it(
    bright: Path, tmp_path: Path
) -> None:
    steps = [
        *READY,
        {"name": "_", "script": "atRest(0)"},
        {"name": "_", "script": SLOW},
        at_pace(16),
        {"name": "_", "script": "viewer().scene.setLevel(0)"},
        {"name": "changed", "script": "atRest(0)"},
        {"name": "level 0", "script": f"viewer().scene.settled().then(() => {PICTURE})"},
    ]
    with pages(bright) as address:
        found = visit(f"{address}/?noui", tmp_path, steps, init=AT_REST).results
    assert psnr(pixels(found["changed"]), pixels(found["level 0"])) >= SAME_DB


COUNTED = """(({ scene } = viewer()) => {
  const draw = scene.renderer.draw.bind(scene.renderer);
  globalThis.draws = 0;
  scene.renderer.draw = (frame) => {
    draws++;
    draw(frame);
  };
  scene.picture.keptAt = -1e6;
})()"""
LATER = "new Promise((done) => setTimeout(() => done(draws), 500))"


def test_a_slow_device_draws_a_change_once(bright: Path, tmp_path: Path) -> None:
    """And once more to keep the picture; a change that fades is drawn some 25 times."""
    steps = [
        *READY,
        {"name": "_", "script": "atRest(0)"},
        {"name": "_", "script": COUNTED},
        at_pace(20_000),
        {"name": "_", "script": "draws = 0, viewer().scene.setLevel(0)"},
        {"name": "changed", "script": "atRest(0)"},
        {"name": "slow", "script": "draws"},
        {"name": "level 0", "script": f"viewer().scene.settled().then(() => {PICTURE})"},
    ]
    with pages(bright) as address:
        found = visit(f"{address}/?noui", tmp_path, steps, init=AT_REST).results
    assert found["slow"] <= 3
    assert psnr(pixels(found["changed"]), pixels(found["level 0"])) >= SAME_DB


@pytest.mark.parametrize("state", ["panes[0].sorting", "waits"])
def test_a_slow_device_draws_no_picture_that_another_follows(
    state: str, bright: Path, tmp_path: Path
) -> None:
    """While splats are sorted or more come; not for ever, and not while the camera moves."""
    steps = [
        *READY,
        {"name": "_", "script": "atRest(0)"},
        {"name": "_", "script": COUNTED},
        at_pace(50),
        {"name": "_", "script": "viewer().scene.wake()"},
        {"until": "draws > 0"},
        {"name": "_", "script": f"viewer().scene.{state} = true"},
        at_pace(20_000),
        {"name": "_", "script": "draws = 0, viewer().scene.wake()"},
        {"name": "overtaken", "script": LATER},
        {"name": "_", "script": "viewer().scene.move()"},
        {"until": "draws > 0"},
        at_pace(200),
        {"name": "_", "script": LATER},
        {"name": "_", "script": "draws = 0, viewer().scene.wake()"},
        {"until": "draws > 0"},
    ]
    with pages(bright) as address:
        found = visit(f"{address}/?noui", tmp_path, steps, init=AT_REST).results
    assert found["overtaken"] == 0
