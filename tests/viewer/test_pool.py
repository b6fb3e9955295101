"""Large scenes: unpacked by several workers."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.viewer.browser import MISSING, pages, pinhole, visit
from gsynopsis.container.writer import encode_with_account
from gsynopsis.records import LevelSet
from gsynopsis.serve.run import serving
from tests.level_sets import PLAIN_SPLATS, make_level_set
from tests.viewer.bright import camera_of
from tests.viewer.node import needs_node, run_node
from tests.viewer.unseen import UNSEEN
from tests.viewer.watched import Span, Watched

needs_browser = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"
)
LARGE = (2_000, 12_000, 60_000, 260_000)


def many_splats(anchors: tuple[int, ...] = LARGE) -> LevelSet:
    """Small and opaque, all over the scene."""
    levels = make_level_set(np.random.default_rng(5), replace(PLAIN_SPLATS, anchors=anchors))
    levels.shared.log_scales[:] -= 1
    levels.shared.residual[:, 3] += 1.5
    return levels


def cores(count: int) -> str:
    """The page takes its machine for one of so many cores."""
    return (
        "Object.defineProperty(Navigator.prototype, 'hardwareConcurrency', "
        f"{{ get: () => {count} }});"
    )


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, LevelSet]:
    levels = many_splats()
    path = tmp_path_factory.mktemp("large") / "large.gsyn"
    path.write_bytes(encode_with_account(levels, "compact", "large", 8192)[0])
    return path, levels


@needs_browser
def test_pictures_of_several_workers_are_those_of_one(
    large: tuple[Path, LevelSet], tmp_path: Path
) -> None:
    file, levels = large
    camera = pinhole(camera_of(levels))
    shots: list[dict[str, Any]] = [
        {"name": f"L{k}", "script": f"picture({camera}, {k})"} for k in range(4)
    ]
    steps = [
        {"wait": "complete"},
        {"name": "workers", "script": "viewer().scene.memory.workers"},
        *shots,
    ]
    still = {"reducedMotion": "reduce"}
    found = {}
    for count in (1, 5):
        with pages(file) as address:
            url = f"{address}/?noui&budget=1000000"
            init = cores(count) + UNSEEN
            found[count] = visit(url, tmp_path, steps, init=init, context=still)
        assert not found[count].times("error")
        ready = [event["level"] for event in found[count].times("level-ready")]
        assert ready == [0, 1, 2, 3], "levels are told in their order"
    one, several = (found[count].results for count in (1, 5))
    assert (one.pop("workers"), several.pop("workers")) == (1, 4)
    assert one["L3"]["pixels"] != one["L2"]["pixels"]
    for name, picture in one.items():
        assert several[name] == picture, name


@needs_browser
def test_a_small_scene_starts_no_further_worker(bright: Path, tmp_path: Path) -> None:
    steps = [{"wait": "complete"}, {"name": "n", "script": "viewer().scene.memory.workers"}]
    with pages(bright) as address:
        found = visit(f"{address}/?noui", tmp_path, steps, init=cores(16))
    assert found.results["n"] == 1


@needs_browser
def test_what_several_workers_find_damaged_is_asked_for_again(
    large: tuple[Path, LevelSet], tmp_path: Path
) -> None:
    """A byte of a block of the finest level is wrong the first time, or always."""
    file, _ = large
    data = file.read_bytes()
    at = len(data) - 50_000
    for times in (1, 100):
        left = times

        def change(body: bytes, span: Span) -> bytes:
            nonlocal left
            if not left or not span[0] <= at < span[1]:
                return body
            left -= 1
            wrong = bytearray(body)
            wrong[at - span[0]] ^= 1
            return bytes(wrong)

        with serving(Watched(file, change)) as address:
            url = f"{address}/?noui&budget=1000000"
            wait = {"wait": "complete" if times == 1 else "error"}
            found = visit(url, tmp_path, [wait], init=cores(5) + UNSEEN)
        troubles = [event["trouble"] for event in found.times("error")]
        assert troubles == ([] if times == 1 else ["ChecksumError"])


@needs_node
def test_what_a_broken_worker_has_not_done_is_done_by_others(bright: Path) -> None:
    """None, one and both of two workers break."""
    found = json.loads(run_node("unpack_pool.mjs", bright))
    assert [entry["ended"] for entry in found] == [0, 1, 2]
    for entry in found:
        assert entry["blocks"] > 3
        assert (entry["differ"], entry["trouble"]) == (0, "ChecksumError")


@needs_node
def test_what_has_come_is_given_in_order_and_no_frame_gets_more_than_its_room() -> None:
    room, row = 4096, 2048
    for length, frames in json.loads(run_node("upload_queue.mjs")).items():
        *before, late = frames
        assert late == [["late", 0, room]], "a rest is not taken for a long frame"
        most = room * min(16, max(1, int(length) / (1000 / 60))) + row
        assert all(sum(to - at for _, at, to in frame) <= most for frame in before), length
        parts = [part for frame in before for part in frame]
        assert "dropped" not in {name for name, _, _ in parts if length == "17"}
        for name, count in (("first", 100_000), ("second", 5000), ("end", 0)):
            own = [(at, to) for part, at, to in parts if part == name]
            assert own[0][0] == 0 and own[-1][1] == count, name
            assert all(a[1] == b[0] and a[1] % row == 0 for a, b in pairwise(own)), name
        names = [name for name, _, _ in parts if name != "dropped"]
        assert names == sorted(names, key=["first", "second", "end"].index)
    assert len(frames) < 10, "where frames take long, few are needed"


COUNTED = """
globalThis.most = 0;
let sent = 0;
const draw = WebGL2RenderingContext.prototype.texSubImage2D;
WebGL2RenderingContext.prototype.texSubImage2D = function counted(...values) {
  sent += values[8].byteLength ?? 0;
  globalThis.most = Math.max(globalThis.most, sent);
  return draw.apply(this, values);
};
WebGL2RenderingContext.prototype.drawArraysInstanced = () => {};
const real = requestAnimationFrame;
let last = 0, shown = performance.now();
globalThis.requestAnimationFrame = (call) => real((now) => {
  if (now !== last) [last, shown, sent] = [now, shown + 16, 0];
  call(shown);
});
"""
"""Bytes of tables that a frame gives to the device, at most; frames seem to take 16 ms.

No splats are drawn: without a graphics card that takes half a second for each of them.
"""


@needs_browser
def test_a_frame_gives_the_device_a_slice_of_what_has_come(
    large: tuple[Path, LevelSet], tmp_path: Path
) -> None:
    """All 260,000 splats are decoded at once for another view: 8 MiB of attributes."""
    file, levels = large
    camera = pinhole(camera_of(levels))
    steps: list[dict[str, Any]] = [
        {"wait": "complete"},
        {"name": "all", "script": f"picture({camera}, 3)"},
        {"name": "most", "script": "most"},
    ]
    with pages(file) as address:
        url = f"{address}/?noui&budget=1000000"
        found = visit(url, tmp_path, steps, init=COUNTED).results
    assert 2**20 < found["most"] < 6 * 2**20
    assert levels.levels[-1].live * 32 > 7 * 2**20
