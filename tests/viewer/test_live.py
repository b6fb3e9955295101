"""A page that follows a file while it is written anew, as `train --viewer` does."""

from pathlib import Path
from typing import Any

import pytest
from starlette.responses import JSONResponse, Response
from starlette.types import Receive, Scope, Send

from benchmarks.viewer.browser import MISSING, pinhole, pixels, psnr, visit
from gsynopsis.container import Assembler, decode
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import Root
from gsynopsis.serve.page import FOLDER
from gsynopsis.serve.run import serving
from tests.viewer.bright import LEAST_DB, camera_of, drawn_by_cpu

pytestmark = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"
)
NOTE = "viewer().shadowRoot.querySelector('.note')"
SAID = f"new Promise((r) => setTimeout(() => r({NOTE}.hidden ? '' : {NOTE}.textContent), 700))"
POSE = "viewer().scene.camera.pose"
COMPLETE = "seen.filter((event) => event.name === 'complete').length"
COUNT = """(() => {
  const { scene } = viewer();
  const { renderer } = scene;
  const draw = renderer.draw.bind(renderer);
  globalThis.frames = globalThis.blank = 0;
  renderer.draw = (frame) => {
    frames++;
    if (!scene.drawn) blank++;
    draw(frame);
  };
})()"""
"""Counts frames from now on, and those without a splat."""
NAME = "live.gsyn"


def put(number: int) -> str:
    """A step that asks the server for another version and waits until it is shown."""
    wanted = f"{COMPLETE} > before"
    return (
        f"(async () => {{ const before = {COMPLETE}; await fetch('/put/{number}');"
        f"while (!({wanted})) await new Promise((r) => setTimeout(r, 50)); }})()"
    )


class Writing:
    """A server that puts another content into its file when a page asks for it."""

    def __init__(self, folder: Path, contents: list[bytes | None]) -> None:
        self.app = make_app(Root(folder.resolve(), NAME), viewer=FOLDER)
        self.path, self.contents = folder / NAME, contents

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["path"].startswith("/put/"):
            content = self.contents[int(scope["path"].rsplit("/", 1)[1])]
            if content is None:
                self.path.unlink()
            else:
                temporary = self.path.with_suffix(".tmp")
                temporary.write_bytes(content)
                temporary.replace(self.path)
            await Response(status_code=204)(scope, receive, send)
            return
        await self.app(scope, receive, send)


def test_the_page_goes_on_to_each_newer_version_from_where_it_looks(
    bright: Path, tmp_path: Path
) -> None:
    whole = bright.read_bytes()
    levels = decode(whole, "scene")
    index = Assembler(whole, "scene").index
    # First a file of two levels, then all of it, as of a training that has more to show.
    contents: list[bytes | None] = [
        whole[: index.levels[1].end],
        whole,
        whole[: len(whole) // 2],
        None,
    ]
    camera = camera_of(levels)
    look = f"picture({pinhole(camera)}, null)"
    steps: list[dict[str, Any]] = [
        {"name": "none", "script": SAID},
        {"name": "_", "script": put(0)},
        {"name": "first", "script": look},
        {"drag": [[60, 60], [120, 70]]},
        {"name": "pose", "script": POSE},
        {"name": "_", "script": COUNT},
        {"name": "_", "script": put(1)},
        {"name": "second", "script": look},
        {"name": "blank", "script": "[frames, blank]"},
        {"name": "same pose", "script": POSE},
        {"name": "broken", "script": f"fetch('/put/2').then(() => {SAID})"},
        {"name": "after broken", "script": look},
        {"name": "gone", "script": f"fetch('/put/3').then(() => {SAID})"},
        {"name": "after gone", "script": look},
    ]
    with serving(Writing(tmp_path, contents)) as address:
        found = visit(f"{address}/?noui&content={NAME}&live=0.2", tmp_path, steps)
    results = found.results
    pictures = drawn_by_cpu(levels, camera)
    assert "nothing to show yet" in results["none"]
    assert psnr(pixels(results["first"]), pictures[1]) >= LEAST_DB
    for name in ("second", "after broken", "after gone"):
        assert psnr(pixels(results[name]), pictures[3]) >= LEAST_DB, name
    assert results["same pose"] == results["pose"]
    frames, blank = results["blank"]
    assert frames > 0 and blank == 0, "the old picture stays until the new one is there"
    assert results["broken"] == ""
    assert "last picture" in results["gone"]
    assert not found.times("error")
    assert not [line for line in found.said if line.startswith("pageerror")]


REPORT: dict[str, Any] = {
    "phase": "full",
    "step": 1210,
    "steps": 6000,
    "loss": 0.0412,
    "held_out": {"psnr": 27.31, "step": 1180, "views": 2},
    "remaining": 200.0,
    "finished": False,
    "version": {"step": 1180, "bytes": 0},
    "curve": [[1, 0.3], [600, 0.1], [1200, 0.0412]],
}


class Telling(Writing):
    """Tells beside the file how its training goes; from the second version on, that it is over."""

    def __init__(self, folder: Path, content: bytes) -> None:
        super().__init__(folder, [content])
        self.asked, self.finished = 0, False

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["path"] == "/finish":
            self.finished = True
        if scope["path"] not in ("/live.json", "/finish"):
            await super().__call__(scope, receive, send)
            return
        self.asked += 1
        size = self.path.stat().st_size
        version = {**REPORT["version"], "bytes": size}
        over = {"finished": True, "step": 6000, "remaining": None} if self.finished else {}
        report = {**REPORT, "version": version, **over}
        await JSONResponse(report)(scope, receive, send)


def test_the_page_tells_how_the_training_goes(small: Path, tmp_path: Path) -> None:
    panel = "viewer().shadowRoot.querySelector('.training')"
    boxes = (
        f"[{panel}, viewer().shadowRoot.querySelector('.bar')]"
        ".map((e) => e.getBoundingClientRect().toJSON())"
    )
    (tmp_path / NAME).write_bytes(small.read_bytes())
    sizes = [(1280, 720), (390, 844), (600, 338)]
    steps: list[dict[str, Any]] = [
        {"wait": "complete"},
        {"until": f"{panel}.innerText.includes('shown')"},
        {"name": "text", "script": f"{panel}.innerText"},
        {"name": "points", "script": f"{panel}.querySelector('polyline').points.length"},
        *[
            step
            for size in sizes
            for step in ({"size": size}, {"name": f"{size}", "script": boxes})
        ],
        {"name": "_", "script": "fetch('/finish').then(() => 0)"},
        {"until": f"{panel}.innerText.includes('Trained')"},
        {"name": "over", "script": f"{panel}.innerText"},
        {"name": "_", "script": "viewer().removeAttribute('live')"},
        {"name": "hidden", "script": f"{panel}.hidden"},
    ]
    with serving(Telling(tmp_path, small.read_bytes())) as address:
        found = visit(f"{address}/?content={NAME}&live=0.2", tmp_path, steps, sizes[0]).results
    size = f"{small.stat().st_size / 2**20:.2f} MiB"
    for words in ("full", "3 min left", "1,210 of 6,000", "0.0412", "27.31 dB", "1,180", size):
        assert words in found["text"], words
    assert found["points"] == 3
    for width, height in sizes:
        box, bar = found[f"{(width, height)}"]
        assert box["left"] >= 0 and box["right"] <= width and box["bottom"] < bar["top"], width
        assert box["width"] * box["height"] < 0.25 * width * height
    assert "6,000 of 6,000" in found["over"] and "left" not in found["over"]
    assert found["hidden"] is True
