"""Scenes of more splats than the budget: what is held, and what becomes of the rest."""

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
from tests.viewer.watched import Span, Watched

needs_browser = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"
)
ANCHORS = (500, 2_000, 8_000, 32_000)
BUDGET = 14_000
BYTES = 32 + 12 + 8
"""Of textures for a splat: attributes, centre, two orders."""


def wide(shape: Shape, folder: Path) -> Path:
    """The file of 32,000 splats in blocks of 512."""
    levels = make_level_set(np.random.default_rng(6), replace(shape, anchors=ANCHORS))
    levels.shared.log_scales[:] -= 0.5
    levels.shared.residual[:, 3] += 1.5
    path = folder / "wide.gsyn"
    path.write_bytes(encode_with_account(levels, "compact", "wide", 512)[0])
    return path


def look(side: int) -> str:
    """A script: look from the middle to one side, wait until nothing more is loaded."""
    camera = f"{{ position: middle, target: middle.map((v, i) => i ? v : v + {side}) }}"
    return (
        f"(async () => {{ const {{ center: middle }} = viewer().scene.facts;"
        f" viewer().camera = {camera}; let before = -1; let quiet = 0;"
        " while (quiet < 15) { await new Promise((r) => setTimeout(r, 100));"
        " const now = `${viewer().scene.drawn} ${viewer().stats.bytes}`;"
        " quiet = now === before ? quiet + 1 : 0; before = now; }"
        " await viewer().scene.settled(); return picture(null, 3); })()"
    )


def read_twice(spans: Sequence[Span]) -> bool:
    return any(before[1] > after[0] for before, after in pairwise(sorted(spans)))


@needs_browser
@pytest.mark.parametrize("shape", [SPLATS, PLAIN_SPLATS], ids=["harmonics", "plain"])
def test_what_is_out_of_sight_makes_room_and_comes_back(shape: Shape, tmp_path: Path) -> None:
    """A budget of 44 % of the splats, of which either side shows about as many."""
    file = wide(shape, tmp_path)
    steps: list[dict[str, Any]] = [
        {"wait": "complete"},
        {"name": "right", "script": look(1)},
        {"name": "left", "script": look(-1)},
        {"name": "again", "script": look(1)},
        {"name": "second", "script": "picture(null, 2)"},
        {"name": "base", "script": "picture(null, 0)"},
        {"name": "tables", "script": "viewer().scene.memory.tables"},
        {"name": "textures", "script": "viewer().scene.textures"},
    ]
    found, watched = {}, {}
    for budget in (BUDGET, 2 * ANCHORS[-1]):
        watched[budget] = Watched(file)
        with serving(watched[budget]) as address:
            url = f"{address}/?noui&budget={budget}"
            found[budget] = visit(url, tmp_path, steps)
        assert not found[budget].times("error")
    bounded, whole = (visited.results for visited in found.values())
    for name in ("right", "left", "again"):
        assert psnr(pixels(bounded[name]), pixels(whole[name])) >= LEAST_DB, name
    assert psnr(pixels(whole["second"]), pixels(whole["again"])) < LEAST_DB - 5
    assert bounded["base"] == whole["base"], "the base stays, and nothing of finer levels shows"
    assert bounded["tables"] < 0.5 * whole["tables"]
    assert bounded["textures"] <= BYTES * (BUDGET + 3 * 1024)
    spans = watched[BUDGET].spans
    assert sum(end - start for start, end in spans) > 0.55 * file.stat().st_size
    assert not read_twice(spans), "what comes back is decoded from the bytes that were kept"


@needs_node
def test_blocks_have_the_cheapest_rows_and_nobody_elses() -> None:
    found = json.loads(run_node("room.mjs"))
    assert found["wrong"] == []
    assert found["refused"] > 100 < found["swapped"]
