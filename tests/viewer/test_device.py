"""A graphics device that goes away, and one that has too little memory."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.viewer.browser import MISSING, pages, pinhole, pixels, psnr, screenshot, visit
from gsynopsis.container import decode
from tests.viewer.bright import LEAST_DB, camera_of, drawn_by_cpu

pytestmark = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"
)
ROOT = "viewer().shadowRoot"
NOTE = f"{ROOT}.querySelector('.note')"
SAID = f"{NOTE}.checkVisibility() ? {NOTE}.textContent : ''"
DEVICE = f"{ROOT}.querySelector('canvas').getContext('webgl2').getExtension('WEBGL_lose_context')"


def shot(path: Path) -> np.ndarray:
    """The lower half of a screenshot: words stand in the upper one."""
    image = screenshot(path)
    return image[image.shape[0] // 2 :]


def test_the_last_picture_stays_while_the_device_is_lost(bright: Path, tmp_path: Path) -> None:
    levels = decode(bright.read_bytes(), "scene")
    camera = camera_of(levels)
    steps: list[dict[str, Any]] = [
        {"wait": "complete"},
        {"name": "_", "script": "viewer().scene.settled()"},
        {"until": "!viewer().scene.unkept"},
        {"shot": "before"},
        {"name": "_", "script": f"(globalThis.device = {DEVICE}, device.loseContext(), 0)"},
        {"until": f"!{ROOT}.querySelector('.still').hidden"},
        {"shot": "lost"},
        {"name": "lost", "script": SAID},
        {"name": "_", "script": "(device.restoreContext(), 0)"},
        {"until": "!viewer().scene.lost"},
        {"name": "_", "script": "viewer().scene.settled()"},
        {"shot": "after"},
        {"name": "after", "script": SAID},
        {"name": "kept", "script": "viewer().shadowRoot.querySelector('.still').hidden"},
        {"name": "L3", "script": f"picture({pinhole(camera)}, 3)"},
        {"name": "L0", "script": f"picture({pinhole(camera)}, 0)"},
    ]
    with pages(bright) as address:
        found = visit(f"{address}/?noui", tmp_path, steps, (480, 320))
    before, lost, after = (shot(tmp_path / f"{name}.png") for name in ("before", "lost", "after"))
    assert before.std() > 0.05, "the scene is not on screen"
    assert psnr(lost, before) >= LEAST_DB
    assert psnr(after, before) >= LEAST_DB
    said = found.results["lost"]
    assert "lost" in said and said.endswith(".") and said in "".join(found.said)
    assert found.results["after"] == "" and found.results["kept"] is True
    assert not found.times("error")
    pictures = drawn_by_cpu(levels, camera)
    for name, expected in (("L3", pictures[3]), ("L0", pictures[0])):
        assert psnr(pixels(found.results[name]), expected) >= LEAST_DB


def test_a_small_device_shows_the_finest_level_that_fits(bright: Path, tmp_path: Path) -> None:
    """Graphics memory for less than all levels: textures of more rows are refused."""
    levels = decode(bright.read_bytes(), "scene")
    rows = [-(-(-(-level.live // 1024) + 1) * 1024 // 1024) for level in levels.levels]
    assert rows[1] < rows[2]
    small = f"""
    {{ const {{ texStorage2D, getError }} = WebGL2RenderingContext.prototype;
      let full = false;
      Object.assign(WebGL2RenderingContext.prototype, {{
        texStorage2D(...words) {{
          full ||= words[4] > {rows[1]};
          if (!full) texStorage2D.apply(this, words);
        }},
        getError() {{
          const found = full ? this.OUT_OF_MEMORY : getError.call(this);
          full = false;
          return found;
        }},
      }}); }}"""
    camera = camera_of(levels)
    steps: list[dict[str, Any]] = [
        {"wait": "complete"},
        {"wait": "base-ready"},
        {"name": "note", "script": SAID},
        {"name": "most", "script": "viewer().shadowRoot.querySelectorAll('input')[1].max"},
        {"name": "picture", "script": f"picture({pinhole(camera)}, null)"},
    ]
    with pages(bright) as address:
        found = visit(f"{address}/?noui", tmp_path, steps, init=small)
    assert "not enough graphics memory" in found.results["note"]
    assert "level 1 of 3" in found.results["note"]
    assert found.results["most"] == "2", "levels 0 and 1, and auto"
    # What was under way when the device was found small may still come.
    assert [event["level"] for event in found.times("level-ready")][:2] == [0, 1]
    assert len(found.times("complete")) == 1
    expected = drawn_by_cpu(levels, camera)[1]
    assert psnr(pixels(found.results["picture"]), expected) >= LEAST_DB
    assert not found.times("error")


def test_without_memory_for_refinement_the_base_stays(bright: Path, tmp_path: Path) -> None:
    """The decoder's arrays of the finer levels are refused, as a browser refuses them."""
    levels = decode(bright.read_bytes(), "scene")
    most = 6 * levels.levels[1].anchors
    inside = f"""
      const Usual = Float32Array;
      globalThis.Float32Array = class extends Usual {{
        constructor(...words) {{
          if (words[0] === {6 * levels.levels[2].anchors}) {{
            throw new RangeError("Array buffer allocation failed");
          }}
          super(...words);
        }}
      }};"""
    assert most < 6 * levels.levels[2].anchors
    small = f"""
    globalThis.Worker = class extends globalThis.Worker {{
      constructor(address, options) {{
        const script = {inside!r} + `await import(${{JSON.stringify(address)}});`;
        const early = `const early = []; globalThis.onmessage = (event) => early.push(event);`;
        const late = `for (const event of early) globalThis.onmessage(event);`;
        const blob = new Blob([early + script + late], {{ type: "text/javascript" }});
        super(URL.createObjectURL(blob), options);
      }}
    }};"""
    camera = camera_of(levels)
    steps: list[dict[str, Any]] = [
        {"wait": "error"},
        {"wait": "base-ready"},
        {"until": f"({SAID}).includes('memory')"},
        {"name": "note", "script": SAID},
        {"name": "picture", "script": f"picture({pinhole(camera)}, 0)"},
    ]
    with pages(bright) as address:
        found = visit(f"{address}/?noui", tmp_path, steps, init=small)
    assert "not enough memory" in found.results["note"]
    expected = drawn_by_cpu(levels, camera)[0]
    assert psnr(pixels(found.results["picture"]), expected) >= LEAST_DB
    assert not [line for line in found.said if line.startswith("pageerror")]
