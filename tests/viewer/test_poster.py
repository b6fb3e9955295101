"""The tiny picture that a page shows until something of the scene is there."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from benchmarks.viewer.browser import MISSING, visit
from gsynopsis.container import encode
from gsynopsis.container.index import parse_index
from gsynopsis.container.notes.poster import poster_text
from gsynopsis.records import POSTER_NOTE
from gsynopsis.serve.run import serving
from tests.container.posters import GOOD, REFUSED, webp
from tests.viewer.bright import bright_levels
from tests.viewer.node import needs_node, run_node
from tests.viewer.watched import Watched

COLOUR = (200, 120, 40)
POSTER = "viewer().shadowRoot.querySelector('.poster')"
NOTE = "viewer().shadowRoot.querySelector('.note').textContent"


@needs_node
def test_the_viewer_takes_and_refuses_what_python_does(tmp_path: Path) -> None:
    path = tmp_path / "notes.json"
    path.write_text(json.dumps([*GOOD.values(), *REFUSED.values()]))
    taken = json.loads(run_node("poster.mjs", path))
    assert taken == [True] * len(GOOD) + [False] * len(REFUSED)


@pytest.mark.skipif(bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser")
def test_the_poster_and_per_cent_show_until_the_base_is_there(tmp_path: Path) -> None:
    """The server keeps half of the base back until both are seen."""
    file = tmp_path / "scene.gsyn"
    note = poster_text(webp(48, 32, COLOUR))
    file.write_bytes(encode(replace(bright_levels(), meta={POSTER_NOTE: note}), "compact"))
    held = parse_index(file.read_bytes(), "scene").levels[0].end // 2
    watched = Watched(file, held=held)
    seen = f"{POSTER}?.width === 48 && {NOTE}.includes('%')"
    wait = (
        f"new Promise((done) => {{ const look = () => {{ if ({seen}) setTimeout(done, 0, {NOTE});"
        " else requestAnimationFrame(look); }; look(); })"
    )
    steps: list[dict[str, Any]] = [
        {"name": "says", "script": wait},
        {"shot": "poster"},
        {"name": "ready", "script": "seen.filter((event) => event.name === 'base-ready').length"},
        {"name": "_", "script": "fetch('go').then(() => 0)"},
        {"wait": "complete"},
        {"wait": "base-ready"},
        {
            "name": "after",
            "script": f"[{POSTER}, viewer().shadowRoot.querySelector('.note').hidden]",
        },
    ]
    with serving(watched) as address:
        found = visit(f"{address}/?noui&content=scene.gsyn", tmp_path, steps).results
    assert found["ready"] == 0
    share = int(found["says"].removeprefix("Loading… ").removesuffix(" %"))
    assert 40 <= share <= 60
    image = np.asarray(Image.open(tmp_path / "poster.png").convert("RGB"), np.float64)
    assert np.abs(image[image.shape[0] // 2 :].mean(axis=(0, 1)) - COLOUR).max() < 12
    assert found["after"] == [None, True]
