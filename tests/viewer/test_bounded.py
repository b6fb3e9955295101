"""Scenes that are larger than the budget: what is held, and what becomes of the rest."""

import json
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.viewer.browser import MISSING, pixels, psnr, visit
from gsynopsis.container.writer import encode_with_account
from gsynopsis.serve.run import serving
from tests.level_sets import PLAIN_SPLATS, SPLATS, Shape, make_level_set
from tests.viewer.bright import LEAST_DB
from tests.viewer.node import needs_node, run_node
from tests.viewer.unseen import UNSEEN
from tests.viewer.watched import Span, Watched

needs_browser = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"
)
ANCHORS = (500, 2_000, 8_000, 32_000)
ANCHORED = Shape(slots=3, grids=(0,) * 4, features=0, entries=0, code_width=0, residual=7, hidden=8)
SHARE = 0.44
"""Of the scene, which either side shows about as much of."""
BYTES = 32 + 12 + 8
"""Of textures for a splat: attributes, centre, two orders."""


def wide(shape: Shape, folder: Path) -> tuple[Path, int]:
    """The file of 32,000 splats or anchors in blocks of 512, and how many splats it draws."""
    levels = make_level_set(np.random.default_rng(6), replace(shape, anchors=ANCHORS))
    if shape.degree is None:
        middle = (levels.shared.lattice * levels.frame.voxel).mean(axis=0)
        levels = replace(levels, frame=replace(levels.frame, center=middle))
        sizes = levels.shared.log_scales
        sizes[:] = 0.7 * sizes - 1.2
        sizes[:, 3:] += 0.5
        for level in levels.levels:
            level.networks["opacity_b2"][:] += 0.7
            level.networks["color_b2"][:] = np.random.default_rng(7).standard_normal(9)
    else:
        levels.shared.log_scales[:] -= 0.5
        levels.shared.residual[:, 3] += 1.5
    path = folder / "wide.gsyn"
    path.write_bytes(encode_with_account(levels, "compact", "wide", 512)[0])
    return path, levels.levels[-1].live


QUIET = (
    "let before = -1; let quiet = 0;"
    " while (quiet < 20) { await new Promise((r) => setTimeout(r, 100));"
    " const { bytes, decodeSeconds } = viewer().stats;"
    " const now = `${viewer().scene.drawn} ${bytes} ${decodeSeconds}`;"
    " quiet = now === before ? quiet + 1 : 0; before = now; }"
)
"""Wait until nothing more is loaded: blocks come 0.6 s after those that make room for them, and
later beside other work."""


def look(side: int, wait: str) -> str:
    """A script: look from the middle to one side."""
    camera = f"{{ position: middle, target: middle.map((v, i) => i ? v : v + {side}) }}"
    return (
        f"(async () => {{ const {{ center: middle }} = viewer().scene.facts;"
        f" viewer().camera = {camera}; {wait}"
        " await viewer().scene.settled(); return picture(null, 3); })()"
    )


def read_twice(spans: Sequence[Span]) -> bool:
    return any(before[1] > after[0] for before, after in pairwise(sorted(spans)))


@needs_browser
@pytest.mark.parametrize(
    "shape", [SPLATS, PLAIN_SPLATS, ANCHORED], ids=["harmonics", "plain", "anchors"]
)
def test_what_is_out_of_sight_makes_room_and_comes_back(shape: Shape, tmp_path: Path) -> None:
    file, splats = wide(shape, tmp_path)
    small = round(SHARE * splats)
    found, watched = {}, {}
    for budget in (small, 2 * splats):
        # All is there already where all has room, and how it comes is not looked at.
        wait, init = (QUIET, "") if budget == small else ("", UNSEEN)
        steps: list[dict[str, Any]] = [
            {"wait": "complete"},
            {"name": "right", "script": look(1, wait)},
            {"name": "left", "script": look(-1, wait)},
            {"name": "again", "script": look(1, wait)},
            {"name": "second", "script": "picture(null, 2)"},
            {"name": "base", "script": "picture(null, 0)"},
            {"name": "tables", "script": "viewer().scene.memory.tables"},
            {"name": "textures", "script": "viewer().scene.renderer.bytes"},
        ]
        watched[budget] = Watched(file)
        with serving(watched[budget]) as address:
            url = f"{address}/?noui&budget={budget}"
            found[budget] = visit(url, tmp_path, steps, init=init)
        assert not found[budget].times("error")
    bounded, whole = (visited.results for visited in found.values())
    for name in ("right", "left", "again"):
        assert psnr(pixels(bounded[name]), pixels(whole[name])) >= LEAST_DB, name
    assert psnr(pixels(whole["second"]), pixels(whole["again"])) < LEAST_DB - 5
    assert bounded["base"] == whole["base"], "the base stays, and nothing of finer levels shows"
    # Rows for anchors are a quarter more than slots have on average.
    assert bounded["tables"] < (0.6 if shape is ANCHORED else 0.5) * whole["tables"]
    assert bounded["textures"] <= BYTES * (small + 3 * 1024)
    spans = watched[small].spans
    assert sum(end - start for start, end in spans) > 0.55 * file.stat().st_size
    assert not read_twice(spans), "what comes back is decoded from the bytes that were kept"


SMALL_TEXTURES = """
globalThis.heights = [];
const { getParameter, texStorage2D } = WebGL2RenderingContext.prototype;
Object.assign(WebGL2RenderingContext.prototype, {
  getParameter(name) {
    return name === this.MAX_TEXTURE_SIZE ? MOST : getParameter.call(this, name);
  },
  texStorage2D(...options) {
    heights.push(options[4]);
    texStorage2D.apply(this, options);
  },
});
"""


@needs_browser
def test_a_device_of_small_textures_is_given_none_that_is_larger(tmp_path: Path) -> None:
    """A texture that a device cannot make stays empty, and so did the picture."""
    rows = 16
    file, splats = wide(PLAIN_SPLATS, tmp_path)
    assert splats > 1024 * rows
    steps = [
        {"wait": "complete"},
        {"name": "heights", "script": "heights"},
        {"name": "drawn", "script": "viewer().scene.settled().then(() => viewer().scene.drawn)"},
    ]
    with serving(Watched(file)) as address:
        init = SMALL_TEXTURES.replace("MOST", str(rows))
        found = visit(f"{address}/?noui", tmp_path, steps, init=init)
    assert not found.times("error")
    assert max(found.results["heights"]) == rows
    assert found.results["drawn"] > 512 * rows


@needs_browser
@pytest.mark.parametrize(("query", "most"), [("", 10_000), ("&budget=20000", 20_000)])
def test_a_device_of_little_memory_holds_fewer_splats(
    query: str, most: int, tmp_path: Path
) -> None:
    """Unless the page says how many."""
    file, splats = wide(PLAIN_SPLATS, tmp_path)
    init = "Object.defineProperty(Navigator.prototype, 'deviceMemory', { get: () => 0.02 });"
    bound = BYTES * (most + 3 * 1024)
    steps = [
        {"wait": "complete"},
        # What the last change needed is given back once it is over.
        {"until": f"viewer().scene.renderer.bytes <= {bound}"},
        {"name": "textures", "script": "viewer().scene.renderer.bytes"},
    ]
    with serving(Watched(file)) as address:
        found = visit(f"{address}/?noui{query}", tmp_path, steps, init=init)
    assert not found.times("error")
    assert most + 3 * 1024 < splats
    assert found.results["textures"] >= BYTES * (most - 3 * 1024)


@needs_node
@pytest.mark.parametrize("shape", [SPLATS, ANCHORED], ids=["splats", "anchors"])
def test_what_is_drawn_of_blocks_that_come_and_go_is_as_of_these_alone(
    shape: Shape, tmp_path: Path
) -> None:
    """At every level, whatever had their rows before."""
    levels = make_level_set(
        np.random.default_rng(6), replace(shape, anchors=(200, 800, 3000, 9000))
    )
    for level in levels.levels:
        if level.networks:
            level.networks["opacity_b2"][:] += 0.7
    path = tmp_path / "some.gsyn"
    path.write_bytes(encode_with_account(levels, "compact", "some", 128)[0])
    found = json.loads(run_node("residency.mjs", path))
    assert [(each["drawn"], each["wrong"]) for each in found] == [
        (each["expected"], 0) for each in found
    ]
    assert min(each["drawn"] for each in found) > 100
    assert sum(each["lost"] for each in found[3:]) > 100


@needs_node
def test_blocks_have_the_cheapest_rows_and_nobody_elses() -> None:
    found = json.loads(run_node("row_allocator.mjs"))
    assert found["wrong"] == []
    assert found["refused"] > 100 < found["swapped"]
