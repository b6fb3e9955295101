"""Screenshots of the viewer for docs/viewer.md: a window, a phone and an embed, light and dark.

    python -m benchmarks.viewer.shots --file runs/demo/run/scene.gsyn --scene runs/demo/room

Writes docs/viewer_*.png with a palette each. The live page shows a short training of `--scene`;
without one its image stays as it is. `--beside FOLDER` adds SuperSplat's viewer at the same place:
FOLDER is what `npm pack @playcanvas/supersplat-viewer` unpacks to. Needs node, Chromium and
`npm ci` in viewer/.
"""

import json
import math
import re
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import tyro
from PIL import Image

from benchmarks.bench import ROOT
from benchmarks.viewer.browser import MISSING, pages, visit

DOCS = ROOT / "docs"
COLOURS = 256
GAP = 8
"""Pixels between the images of a sheet."""
WIDE, PHONE, EMBED = (1280, 720), (390, 844), (600, 338)
MENU = "viewer().shadowRoot.querySelector('.menu').click()"
Steps = Sequence[dict[str, Any]]


@dataclass(frozen=True)
class Options:
    """Options of the screenshots.

    Attributes:
        file: A scene's file.
        scene: A scene's folder, for the live page.
        steps: Steps of its training.
        seen: Steps after which its page is captured.
        sheets: Screenshots to take of the file, by name; all if none are named.
        beside: The package of SuperSplat's viewer, unpacked.
    """

    file: Path
    scene: Path | None = None
    steps: int = 400
    seen: int = 250
    sheets: tuple[str, ...] = ()
    beside: Path | None = None


@dataclass(frozen=True)
class Shot:
    """One screenshot of the page.

    Attributes:
        size: Width and height of the window, pixels.
        scheme: `light` or `dark`.
        steps: Steps before it; see benchmarks/viewer/browser.mjs.
        query: Query of the address beside the file.
    """

    size: tuple[int, int]
    scheme: str
    steps: Steps = ()
    query: str = ""


HELP: Steps = ({"press": "?"},)
OPEN: Steps = ({"name": "_", "script": MENU},)
SHEETS = {
    "wide": [Shot(WIDE, "dark")],
    "help": [Shot(WIDE, "light", HELP)],
    "split": [Shot(WIDE, "light", (), "&split=0&ministats")],
    "phone": [
        Shot(PHONE, "dark"),
        Shot(PHONE, "light", OPEN),
        Shot(PHONE, "dark", (), "&split=0"),
        Shot(PHONE, "light", HELP),
    ],
    "embed": [
        Shot(EMBED, "dark"),
        Shot(EMBED, "light", OPEN),
        Shot(EMBED, "light", (), "&split=0&ministats"),
        Shot(EMBED, "dark", HELP),
    ],
}
COLUMNS = {"phone": 4, "embed": 2, "live": 2, "beside": 2}
SETTLE = 15_000
"""Milliseconds until the other viewer stands still."""


def touch_of(size: tuple[int, int]) -> dict[str, Any]:
    """Options of a phone's context where it is one."""
    return {"hasTouch": True, "isMobile": True} if size == PHONE else {}


def take(url: str, shot: Shot, folder: Path, ready: Steps) -> Image.Image:
    """The page's picture."""
    # The bar fades where the pointer rests.
    stirred = {"hover": [shot.size[0] // 2, shot.size[1] // 3]}
    steps = [*ready, {"sleep": 1200}, *shot.steps, stirred, {"sleep": 500}, {"shot": "page"}]
    context = {"colorScheme": shot.scheme, **touch_of(shot.size)}
    visit(f"{url}{shot.query}", folder, steps, shot.size, context=context)
    with Image.open(folder / "page.png") as image:
        return image.convert("RGB")


def save(name: str, images: Sequence[Image.Image]) -> None:
    """Put images into one sheet of docs/."""
    columns = COLUMNS.get(name, 1)
    rows = [images[at : at + columns] for at in range(0, len(images), columns)]
    heights = [max(image.height for image in row) for row in rows]
    width = max(sum(image.width + GAP for image in row) for row in rows) - GAP
    sheet = Image.new("RGB", (width, sum(heights) + GAP * (len(rows) - 1)), "white")
    top = 0
    for row, height in zip(rows, heights, strict=True):
        left = 0
        for image in row:
            sheet.paste(image, (left, top))
            left += image.width + GAP
        top += height + GAP
    path = DOCS / f"viewer_{name}.png"
    # Median cut would lose the few pixels of the accent colour.
    small = sheet.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=2)
    small.save(path, optimize=True)
    print(
        f"{path.relative_to(ROOT)}: {sheet.width} × {sheet.height}, {path.stat().st_size:,} bytes"
    )


def take_beside(options: Options, url: str, folder: Path) -> None:
    """Both viewers at the first view of the file, in each size: ours left, SuperSplat's right."""
    assert options.beside is not None
    site = folder / "beside"
    shutil.copytree(options.beside / "public", site)
    command = [sys.executable, "-m", "gsynopsis", "export", str(options.file)]
    subprocess.run([*command, "--out", str(site / "scene.ply")], check=True)
    images: list[Image.Image] = []
    with static(site) as address:
        for size in (WIDE, PHONE, EMBED):
            shot = Shot(size, "dark")
            images.append(take(url, shot, folder, [{"wait": "complete"}]))
            steps = [{"wait": "complete"}, {"name": "camera", "script": "viewer().camera"}]
            camera = visit(url, folder, steps, size, context=touch_of(size)).results["camera"]
            (site / "settings.json").write_text(json.dumps(settings_of(camera, size)))
            # It tells no event that this script knows; SwiftShader draws it in a few seconds.
            query = "/?content=scene.ply&settings=settings.json&webgl&noanim"
            images.append(take(address, replace(shot, query=query), folder, [{"sleep": SETTLE}]))
    halves = [image.resize((image.width // 2, image.height // 2)) for image in images]
    save("beside", halves)


def settings_of(camera: dict[str, Any], size: tuple[int, int]) -> dict[str, Any]:
    """SuperSplat's settings for a camera of ours; its world is turned by half a turn around z."""
    turned = {name: [-x, -y, z] for name in ("position", "target") for x, y, z in [camera[name]]}
    # Its field of view is that of the longer side.
    longer = 2 * math.atan(math.tan(camera["fov"] / 2) * max(size) / min(size))
    off = {"enabled": False}
    effects = {
        "sharpness": {**off, "amount": 0},
        "bloom": {**off, "intensity": 0.1, "blurLevel": 2},
        "grading": {**off, "brightness": 1, "contrast": 1, "saturation": 1, "tint": [1, 1, 1]},
        "vignette": {**off, "intensity": 0.5, "inner": 0.3, "outer": 0.75, "curvature": 1},
        "fringing": {**off, "intensity": 0.5},
    }
    return {
        "version": 2,
        "tonemapping": "none",
        "highPrecisionRendering": False,
        "background": {"color": [0, 0, 0]},
        "postEffectSettings": effects,
        "animTracks": [],
        "cameras": [{"initial": {**turned, "fov": math.degrees(longer)}}],
        "annotations": [],
        "startMode": "default",
    }


@contextmanager
def static(folder: Path) -> Generator[str]:
    """A server of a folder's files; gives its address."""
    handler = partial(QuietHandler, directory=str(folder))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield f"http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()


class QuietHandler(SimpleHTTPRequestHandler):
    """Serves files without a line for each."""

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing."""


@contextmanager
def training(options: Options, folder: Path) -> Generator[str]:
    """A training that has come so far; gives its page's address."""
    command = [sys.executable, "-m", "gsynopsis", "train", str(options.scene)]
    command += ["--out", str(folder / "run"), "--steps", str(options.steps), "--no-evaluate"]
    command += ["--viewer", "--viewer-port", "0"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as child:
        assert child.stderr is not None
        first = next(text for text in child.stderr if "shows the training" in text)
        found = re.match(r"(http://[^/]+/)\S+", first)
        assert found, first
        try:
            report: dict[str, Any] = {"step": 0, "finished": False}
            while report["step"] < options.seen and not report["finished"]:
                time.sleep(1)
                with urllib.request.urlopen(f"{found[1]}live.json") as answer:
                    report = json.loads(answer.read())
            yield found[0]
        finally:
            child.kill()  # What it has learnt is of no use.


def main(options: Options) -> None:
    """Take all of them."""
    if MISSING:
        sys.exit(f"no {MISSING}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with pages(options.file) as address:
            url = f"{address}/?content={options.file.name}"
            for sheet in options.sheets or SHEETS:
                shots = SHEETS[sheet]
                save(sheet, [take(url, shot, folder, [{"wait": "complete"}]) for shot in shots])
            if options.beside is not None:
                take_beside(options, url, folder)
        if options.scene is None:
            return
        shown = "viewer().shadowRoot.querySelector('.training').innerText.includes('shown')"
        ready: Steps = ({"wait": "complete", "timeout": 120000}, {"until": shown})
        with training(options, folder) as url:
            save("live", [take(url, Shot(*kind), folder, ready) for kind in LIVE])


LIVE = [(WIDE, "dark"), (PHONE, "light")]


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
