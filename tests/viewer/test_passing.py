"""Work that a viewer of a large scene spares: unseen levels, drawn arrays, slow frames."""

from pathlib import Path
from typing import Any

import pytest

from benchmarks.viewer.browser import MISSING, pages, pixels, psnr, visit
from tests.viewer.resting import AT_REST, READY
from tests.viewer.test_rest import SAME_DB, anchors_in_blocks, splats_in_blocks

pytestmark = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"
)
WATCHED = """
// Arrays that came in messages; with `unseen` no worker hears that anything was sorted.
globalThis.came = [];
const Plain = Worker;
globalThis.Worker = class extends Plain {
  constructor(...options) {
    super(...options);
    this.addEventListener("message", ({ data }) => {
      for (const { words } of data?.pieces ?? []) came.push(words);
      if (data?.type === "centers") came.push(data.centers);
    });
  }
  postMessage(message, transfer) {
    if (message?.type !== "seen" || !globalThis.unseen) super.postMessage(message, transfer);
  }
};
"""
SETTLED = """((scene) => scene.panes[0].isSettled(scene.seconds()) && !scene.renderer.waits)(
  viewer().scene)"""
UNSEEN = "globalThis.unseen = true;"


@pytest.mark.parametrize("made", [splats_in_blocks, anchors_in_blocks])
def test_a_page_that_says_nothing_ends_with_the_same_picture(made: Any, tmp_path: Path) -> None:
    """How often splats are decoded then, test_splats.py tests where no timing decides it."""
    (path, query) = made(tmp_path)
    steps = [*READY, {"until": SETTLED}, {"name": "last", "script": "atRest(0)"}]
    with pages(path) as address:
        url = f"{address}/?noui{query}"
        seen = visit(url, tmp_path, steps, init=AT_REST + WATCHED).results
        unseen = visit(url, tmp_path, steps, init=AT_REST + WATCHED + UNSEEN).results
    assert psnr(pixels(seen["last"]), pixels(unseen["last"])) >= SAME_DB


def test_what_the_device_has_is_given_back(tmp_path: Path) -> None:
    """Arrays that came in messages are not left to a collector that does not run at rest."""
    (path, _) = splats_in_blocks(tmp_path)
    steps = [
        *READY,
        {"name": "_", "script": "atRest(0)"},
        {"name": "arrays", "script": "came.length"},
        {"name": "kept", "script": "came.filter(({ buffer }) => buffer.byteLength > 0).length"},
    ]
    with pages(path) as address:
        found = visit(f"{address}/?noui", tmp_path, steps, init=AT_REST + WATCHED).results
    assert found["arrays"] > 10
    assert found["kept"] == 0


def test_a_frame_of_more_splats_is_expected_to_take_longer(tmp_path: Path) -> None:
    """Ten times as long at most, as few say little of many; a fast one says nothing."""
    (path, _) = splats_in_blocks(tmp_path)
    after = """
    globalThis.paceAfter = async (milliseconds) => {
      const pace = new (viewer().scene.pace.constructor)();
      const now = performance.now();
      let at = now;
      performance.now = () => at;  // own property: in place of the clock's, until it is deleted
      const finished = async () => { at = now + milliseconds; };
      pace.measure({ finished }, 1000);
      await finished();
      await finished();
      delete performance.now;
      const waits = [1000, 4000, 1e6].map((splats) =>
        [200, 1000, 4000, 20000].filter((since) => pace.skips(since, splats)).length);
      return { slow: [1000, 4000, 1e6].map((splats) => pace.isSlow(splats)), waits };
    };
    """
    steps = [
        *READY,
        {"name": "fast", "script": "paceAfter(1)"},
        {"name": "slow", "script": "paceAfter(150)"},
    ]
    with pages(path) as address:
        found = visit(f"{address}/?noui", tmp_path, steps, init=AT_REST + after).results
    assert found == {
        "fast": {"slow": [False, False, False], "waits": [0, 0, 0]},
        "slow": {"slow": [True, True, True], "waits": [1, 2, 3]},
    }
