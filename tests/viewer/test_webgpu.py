"""The viewer by WebGPU: the pictures of WebGL 2, and what it does where the device is not there."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.viewer.browser import MISSING, pages, pinhole, pixels, psnr, screenshot, visit
from gsynopsis.container import decode, encode
from gsynopsis.model.training_focals import focals_text
from gsynopsis.records import FOCALS_NOTE
from gsynopsis.serve.page import single_page
from tests.viewer.bright import LEAST_DB, bright_levels, camera_of, drawn_by_cpu
from tests.viewer.resting import at_pace
from tests.viewer.test_bounded import ANCHORED, QUIET, SHARE, look, wide

pytestmark = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"
)
ALIKE_DB = 45.0
WEBGPU = {"webgpu": True}
ROOT = "viewer().shadowRoot"
NOTE = f"{ROOT}.querySelector('.note')"
API = "viewer().scene.renderer.api ?? 'WebGL 2'"
LOOKS = """
const pause = (milliseconds) => new Promise((go) => setTimeout(go, milliseconds));
// The devices that the page was given.
globalThis.devices = [];
if (globalThis.GPUAdapter) {
  const { requestDevice } = GPUAdapter.prototype;
  GPUAdapter.prototype.requestDevice = async function (...words) {
    const device = await requestDevice.apply(this, words);
    devices.push(device);
    return device;
  };
}
// Half of the way from the look of one level to that of another.
globalThis.half = async (level) => {
  const { scene } = viewer();
  let clock = scene.seconds() + 100;
  scene.seconds = () => clock;
  scene.setLevel(level);
  const { serial } = scene;
  while (!(scene.panes[0].shown >= serial && scene.panes[0].isSettled(1e9))) await pause(20);
  clock += scene.renderer.fade / 2;
  const { width, height, pixels } = scene.capture(true);
  const found = { width, height, pixels: bytes(await pixels) };
  clock += 100;
  scene.wake();
  while (scene.renderer.layer(0).changing) await pause(20);
  return found;
};
// What the canvas shows once a finer picture has taken the place of the first.
globalThis.resting = async () => {
  const { scene } = viewer();
  let last = null;
  const { frame } = scene.events;
  scene.events.frame = () => {
    frame();
    const { canvas } = scene.renderer;
    const pen = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d");
    pen.fillRect(0, 0, canvas.width, canvas.height);
    pen.drawImage(canvas, 0, 0);
    last = pen.getImageData(0, 0, canvas.width, canvas.height);
  };
  scene.wake();
  for (let before = -1; before !== scene.lastFrame || scene.handle; await pause(300)) {
    before = scene.lastFrame;
  }
  scene.events.frame = frame;
  return { width: last.width, height: last.height, pixels: bytes(last.data) };
};
"""


def both(file: Path, folder: Path, query: str, steps: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Results of a visit by WebGL 2 and of one by WebGPU, without a word of either."""
    steps = [{"wait": "complete"}, {"until": "viewer().tools !== null"}, *steps]
    steps.append({"name": "api", "script": API})
    found = list[dict[str, Any]]()
    with pages(file) as address:
        for renderer, context in (("", {}), ("&renderer=webgpu", WEBGPU)):
            url = f"{address}/?noui{query}{renderer}"
            seen = visit(url, folder, steps, init=LOOKS, context=context)
            assert not seen.times("error")
            found.append(seen.results)
            if renderer:
                assert not seen.said
    assert [each["api"] for each in found] == ["WebGL 2", "WebGPU"]
    return found


def test_every_level_looks_as_by_webgl(bright: Path, tmp_path: Path) -> None:
    levels = decode(bright.read_bytes(), "scene")
    camera = camera_of(levels)
    shots = [{"name": f"L{k}", "script": f"picture({pinhole(camera)}, {k})"} for k in range(4)]
    again = {"name": "again", "script": f"picture({pinhole(camera)}, 0)"}
    webgl, webgpu = both(bright, tmp_path, "", [*shots, again])
    for k, expected in enumerate(drawn_by_cpu(levels, camera)):
        ours = pixels(webgpu[f"L{k}"])
        assert psnr(ours, pixels(webgl[f"L{k}"])) >= ALIKE_DB, k
        assert psnr(ours, expected) >= LEAST_DB, k
    assert webgpu["again"] == webgpu["L0"], "the same splats give other pixels"


def test_fades_sides_places_and_finer_pictures_are_those_of_webgl(tmp_path: Path) -> None:
    """Photos of training were twice as large, so that what rests is drawn larger and halved."""
    plain = bright_levels()
    camera = camera_of(plain)
    levels = replace(plain, meta={FOCALS_NOTE: focals_text([(410.0, 420.0)] * 4)})
    file = tmp_path / "small.gsyn"
    file.write_bytes(encode(levels, "raw"))
    fixed = f"viewer().scene.setPinhole({pinhole(camera)})"
    steps: list[dict[str, Any]] = [
        {"name": "_", "script": f"picture({pinhole(camera)}, 3).then(() => 0)"},
        {"name": "held", "script": "viewer().scene.renderer.bytes"},
        {"name": "_", "script": fixed},
        {"name": "rest", "script": "resting()"},
        at_pace(16),  # a device of long frames would leave fades out
        {"name": "down", "script": "half(0)"},
        {"name": "up", "script": "half(3)"},
        {"name": "after", "script": "viewer().scene.renderer.bytes"},
        {"name": "_", "script": "viewer().setAttribute('split', '0')"},
        {"name": "split", "script": f"picture({pinhole(camera)}, null)"},
        {"name": "_", "script": "viewer().removeAttribute('split')"},
        {"name": "place", "script": "viewer().tools.places.pick(0.5, 0.5)"},
        {"name": "saved", "script": "viewer().picture().then((found) => found.size)"},
        {"size": [200, 120]},
        {"until": "viewer().scene.canvas.width === 200"},
        {"name": "small", "script": "resting()"},
    ]
    webgl, webgpu = both(file, tmp_path, "&level=3", steps)
    for name in ("down", "up", "split", "rest", "small"):
        alike = psnr(pixels(webgpu[name]), pixels(webgl[name]))
        assert alike >= ALIKE_DB, (name, alike)
    assert webgpu["small"]["width"] == 200 and webgpu["saved"] > 1000
    assert webgpu["place"] == pytest.approx(webgl["place"], abs=0.02)
    assert webgpu["after"] == webgpu["held"], "memory of a change is kept"
    ends = [pixels(webgpu[name]) for name in ("down", "split")]
    assert psnr(*ends) < ALIKE_DB, "half of a fade looks as its end"


def test_blocks_under_a_budget_come_and_go_as_by_webgl(tmp_path: Path) -> None:
    """What is out of sight makes room for what comes into it."""
    file, splats = wide(ANCHORED, tmp_path)
    steps: list[dict[str, Any]] = [
        {"name": name, "script": look(side, QUIET)} for name, side in (("right", 1), ("left", -1))
    ]
    webgl, webgpu = both(file, tmp_path, f"&budget={round(SHARE * splats)}", steps)
    for name in ("right", "left"):
        alike = psnr(pixels(webgpu[name]), pixels(webgl[name]))
        assert alike >= ALIKE_DB, (name, alike)
    assert psnr(pixels(webgpu["left"]), pixels(webgpu["right"])) < ALIKE_DB


def test_a_lost_device_comes_again_and_then_webgl_goes_on(bright: Path, tmp_path: Path) -> None:
    levels = decode(bright.read_bytes(), "scene")
    camera = camera_of(levels)
    shot = f"picture({pinhole(camera)}, 3)"
    kept = f"{ROOT}.querySelector('.still').hidden"
    lose = "(globalThis.before = viewer().scene.renderer, devices.at(-1).destroy(), 0)"
    back = {"until": "viewer().scene.renderer !== before && !viewer().scene.lost"}
    steps: list[dict[str, Any]] = [
        {"wait": "complete"},
        {"name": "_", "script": "viewer().scene.settled()"},
        {"until": "!viewer().scene.unkept"},
        {"name": "_", "script": lose},
        back,
        {"name": "again", "script": shot},
        {"name": "api", "script": API},
        {"name": "note", "script": f"{NOTE}.textContent"},
        {"name": "kept", "script": kept},
        {"name": "_", "script": lose},
        back,
        {"name": "webgl", "script": shot},
        {"name": "last", "script": API},
        {"name": "words", "script": f"{NOTE}.textContent"},
        {"name": "canvases", "script": f"{ROOT}.querySelectorAll('.stage > canvas').length"},
        {"name": "_", "script": "viewer().scene.settled()"},
        {"shot": "page"},
    ]
    with pages(bright) as address:
        url = f"{address}/?noui&renderer=webgpu"
        found = visit(url, tmp_path, steps, init=LOOKS, context=WEBGPU)
    expected = drawn_by_cpu(levels, camera)[3]
    results = found.results
    assert (results["api"], results["last"]) == ("WebGPU", "WebGL 2")
    assert results["note"] == "" and results["kept"] is True
    assert "WebGL 2 draws" in results["words"] and results["words"] in "".join(found.said)
    for name in ("again", "webgl"):
        assert psnr(pixels(results[name]), expected) >= LEAST_DB, name
    assert results["canvases"] == 2, "the scene's own and the picture kept"
    assert screenshot(tmp_path / "page.png")[80:].std() > 0.05, "the page is blank"
    assert not found.times("error")


def test_without_an_adapter_webgl_draws_and_says_so(bright: Path, tmp_path: Path) -> None:
    levels = decode(bright.read_bytes(), "scene")
    camera = camera_of(levels)
    page = tmp_path / "scene.html"
    page.write_text(single_page(bright.name, bright.read_bytes()), encoding="utf-8")
    steps: list[dict[str, Any]] = [
        {"wait": "complete"},
        {"name": "L3", "script": f"picture({pinhole(camera)}, 3)"},
        {"name": "api", "script": API},
        {"name": "words", "script": f"{NOTE}.textContent"},
        {"name": "loaded", "script": "performance.getEntriesByType('resource').map((e) => e.name)"},
    ]
    with pages(bright) as address:
        found = visit(f"{address}/?noui&renderer=webgpu", tmp_path, steps)
        usual = visit(f"{address}/?noui", tmp_path, steps)
    alone = visit(f"{page.as_uri()}?renderer=webgpu", tmp_path, steps)
    for each in (found, alone):
        assert each.results["api"] == "WebGL 2"
        assert "WebGPU was asked for" in each.results["words"]
        assert each.results["words"] in json.dumps(each.said)
        drawn = pixels(each.results["L3"])
        assert psnr(drawn, drawn_by_cpu(levels, camera)[3]) >= LEAST_DB
    assert any("gsynopsis-webgpu" in name for name in found.results["loaded"])
    assert not any("gsynopsis-webgpu" in name for name in usual.results["loaded"])
    assert np.array_equal(pixels(found.results["L3"]), pixels(usual.results["L3"]))
