"""The buttons, the menu, the list of keys, and whose the keys are."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from benchmarks.viewer.browser import MISSING, pages, visit

pytestmark = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"
)
ROOT = "viewer().shadowRoot"
HELP = f"{ROOT}.querySelector('.help').checkVisibility()"
FOCUS = f"{ROOT}.activeElement?.ariaLabel"
POSE = "viewer().scene.camera.pose.position.map((v) => v.toFixed(6)).join()"
BOXES = f"""(() => {{
  const box = (e) => {{ const r = e.getBoundingClientRect();
    return {{ left: r.left, top: r.top, right: r.right, bottom: r.bottom }}; }};
  const seen = (list) => [...list].filter((e) => e.checkVisibility({{ visibilityProperty: true }}));
  const bar = {ROOT}.querySelector('.bar');
  const row = [...bar.querySelectorAll(':scope > button, .more:not(.open) button, label')];
  return {{
    bar: box(bar), row: seen(row).map(box),
    menu: seen({ROOT}.querySelectorAll('.more.open, .more.open button')).map(box),
    names: seen(bar.querySelectorAll('button')).map((b) => b.ariaLabel),
    icons: [...bar.querySelectorAll('button')].every((b) => b.querySelector('svg') && b.ariaLabel),
  }};
}})()"""
MENU = f"{ROOT}.querySelector('.menu')"
SIZES = [(1280, 720), (390, 844), (600, 338), (320, 568)]


def inside(box: dict[str, float], size: tuple[int, int]) -> bool:
    width, height = size
    return min(box.values()) >= 0 and box["right"] <= width and box["bottom"] <= height


def check_one_row(found: dict[str, Any], size: tuple[int, int]) -> None:
    bar, row = found["bar"], sorted(found["row"], key=lambda box: box["left"])
    assert inside(bar, size)
    assert bar["bottom"] - bar["top"] <= 52, "more than one row"
    for box in row:
        assert bar["left"] <= box["left"] and box["right"] <= bar["right"]
        assert bar["top"] <= box["top"] and box["bottom"] <= bar["bottom"]
    for before, after in pairwise(row):
        assert before["right"] <= after["left"], "two of them overlap"


def test_the_bar_is_one_row_in_a_view_of_any_size(small: Path, tmp_path: Path) -> None:
    steps: list[dict[str, Any]] = [{"wait": "complete"}]
    for size in SIZES:
        steps += [
            {"size": size},
            {"name": f"{size} plain", "script": BOXES},
            {"name": "_", "script": f"{MENU}.click()"},
            {"name": f"{size} open", "script": BOXES},
            {"name": "_", "script": f"{MENU}.click()"},
            {"name": "_", "script": "viewer().setAttribute('split', '0')"},
            {"name": f"{size} split", "script": BOXES},
            {"name": "_", "script": "viewer().removeAttribute('split')"},
        ]
    with pages(small) as address:
        found = visit(address, tmp_path, steps).results
    for size in SIZES:
        plain, opened = found[f"{size} plain"], found[f"{size} open"]
        check_one_row(plain, size)
        check_one_row(found[f"{size} split"], size)
        assert plain["icons"], "a button without a picture or a name"
        assert {"First view", "Full screen", "Keys and gestures"} <= set(opened["names"])
        if size[0] >= 640:
            continue  # All of it is in the row.
        bar, boxes = plain["bar"], plain["row"] + opened["menu"]
        share = (bar["right"] - bar["left"]) * (bar["bottom"] - bar["top"]) / (size[0] * size[1])
        assert share < 0.08, "the bar covers the picture"
        assert all(box["bottom"] - box["top"] >= 40 for box in boxes), "too small for a finger"
        assert len(opened["menu"]) == 10 and all(inside(box, size) for box in opened["menu"])


def test_keys_work_at_once_and_after_every_button(small: Path, tmp_path: Path) -> None:
    buttons = ("Next view", "Compare two levels", "Light or dark", "Figures")
    steps: list[dict[str, Any]] = [{"wait": "complete"}]
    for k, label in enumerate(("", *buttons)):
        if label:
            steps.append({"clickOn": f"{ROOT}.querySelector('[aria-label=\"{label}\"]')"})
        steps += [{"sleep": 50}, {"name": f"before {k}", "script": POSE}]
        steps += [{"press": "KeyW", "delay": 100}, {"press": "ArrowLeft", "delay": 100}]
        steps += [{"name": f"after {k}", "script": POSE}]
    steps += [{"press": "?"}, {"name": "help", "script": f"[{HELP}, {FOCUS}]"}]
    steps += [{"press": "Escape"}, {"name": "closed", "script": f"[{HELP}, {FOCUS}]"}]
    with pages(small) as address:
        # Wide enough for all buttons in a row, and low: keys are held while frames are drawn.
        found = visit(address, tmp_path, steps, (800, 300)).results
    for k in range(len(buttons) + 1):
        assert found[f"before {k}"] != found[f"after {k}"], f"a key did nothing after button {k}"
    assert found["help"] == [True, "Close"]
    assert found["closed"] == [False, "Figures"], "the focus is back where it was"


def test_the_keyboard_alone_reaches_menu_and_help(small: Path, tmp_path: Path) -> None:
    """On a phone's size; the ring that shows where the focus is has a width."""
    ring = f"getComputedStyle({ROOT}.activeElement).outlineWidth"
    steps: list[dict[str, Any]] = [
        {"wait": "complete"},
        {"name": "focus", "script": f"{ROOT}.querySelector('.stage').focus()"},
        *[{"press": "Tab"} for _ in range(3)],
        {"name": "menu", "script": f"[{FOCUS}, {ring}]"},
        {"press": "Enter"},
        {"press": "Shift+Tab"},
        {"name": "last", "script": FOCUS},
        {"press": "Enter"},
        {"name": "help", "script": f"[{HELP}, {FOCUS}]"},
        {"press": "Escape"},
        {"name": "after", "script": f"[{HELP}, {FOCUS}]"},
        {"press": "Enter"},
        {"press": "Escape"},
        {"name": "open", "script": f"{ROOT}.querySelector('.more').classList.contains('open')"},
    ]
    with pages(small) as address:
        found = visit(address, tmp_path, steps, (390, 844)).results
    assert found["menu"] == ["More", "2px"]
    assert found["last"] == "Keys and gestures"
    assert found["help"] == [True, "Close"]
    assert found["after"] == [False, "More"]
    assert found["open"] is False


def test_words_stand_out_from_their_panels(small: Path, tmp_path: Path) -> None:
    """By the contrast ratio of WCAG, 4.5 at least, over black and over white."""
    colours = (
        f"(() => {{ const s = getComputedStyle({ROOT}.querySelector('.bar'));"
        "return [s.color, s.backgroundColor].map((c) => c.match(/[0-9.]+/g).map(Number)); })()"
    )
    steps: list[dict[str, Any]] = [{"wait": "complete"}, {"name": "light", "script": colours}]
    steps += [{"name": "_", "script": "viewer().setAttribute('theme', 'dark')"}]
    steps += [{"name": "dark", "script": colours}]
    with pages(small) as address:
        found = visit(address, tmp_path, steps, context={"colorScheme": "light"}).results
    for theme in ("light", "dark"):
        ink, (*panel, opacity) = found[theme]
        for behind in (0, 255):
            mixed = [opacity * value + (1 - opacity) * behind for value in panel]
            light, dark = sorted((luminance(ink), luminance(mixed)), reverse=True)
            assert (light + 0.05) / (dark + 0.05) >= 4.5, (theme, behind)
    assert luminance(found["light"][0]) < luminance(found["dark"][0])


def luminance(colour: list[float]) -> float:
    shares = [value / 255 for value in colour[:3]]
    linear = [s / 12.92 if s <= 0.04045 else ((s + 0.055) / 1.055) ** 2.4 for s in shares]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
