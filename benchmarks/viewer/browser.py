"""Chromium, where it is there, and a visit to the viewer's page in it."""

import base64
import json
import shutil
import subprocess
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Timer
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmarks.bench import ROOT
from benchmarks.viewer.node import NODE
from gsynopsis.scene.camera import Camera
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.page import FOLDER
from gsynopsis.serve.run import serving

HERE = Path(__file__).parent
PACKAGES = ROOT / "viewer" / "package.json"
NAMES = ("chromium", "chromium-browser", "google-chrome")
CHROMIUM = next(filter(None, map(shutil.which, NAMES)), None)
PLAYWRIGHT = PACKAGES.parent / "node_modules" / "playwright-core"
NEEDS = {"node": NODE, "Chromium": CHROMIUM, "viewer/node_modules (npm ci)": PLAYWRIGHT.is_dir()}
MISSING = ", ".join(name for name, there in NEEDS.items() if not there)

SIZE = (240, 160)
PATIENCE = 180.0
"""Seconds that a visit takes at most."""


@dataclass(frozen=True)
class Visit:
    """Results of a visit to the page."""

    results: dict[str, Any]
    seen: list[dict[str, Any]]
    said: list[str]

    def times(self, name: str) -> list[dict[str, Any]]:
        """Events of a name, in order."""
        return [event for event in self.seen if event["name"] == name]


Steps = Sequence[dict[str, Any]]


def visit(
    url: str,
    folder: Path,
    steps: Steps,
    size: tuple[int, int] = SIZE,
    heap: bool = False,
    init: str = "",
    context: dict[str, Any] | None = None,
) -> Visit:
    """Open a page of a size, take the steps.

    `heap`: note the memory of page and workers; `init`: runs before the page's own scripts;
    `context`: options of the browser's context, such as `colorScheme` and `hasTouch`,
    and `webgpu` for a browser that has it, drawn by the CPU too.
    """
    request = {
        "url": url,
        "width": size[0],
        "height": size[1],
        "steps": list(steps),
        "out": str(folder),
        "heap": heap,
        "init": init,
        "context": context or {},
        # What is measured is measured in a process that no other page was in.
        "apart": heap or _shared is None,
    }
    if _shared is not None:
        results = _shared.answer(request)
    else:
        with Browser() as browser:
            results = browser.answer(request)
    return Visit(results, results.pop("seen"), results.pop("said"))


class Browser:
    """One Chromium, started at the first request; each request has a page of its own in it."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process is not None:
            # It ends with its input.
            self._process.communicate(timeout=PATIENCE)
            self._process = None

    def answer(self, request: dict[str, Any]) -> dict[str, Any]:
        """Answer of a page; see browser.mjs."""
        if self._process is None or self._process.poll() is not None:
            command = [str(NODE), str(HERE / "browser.mjs"), str(PACKAGES), str(CHROMIUM)]
            pipe = subprocess.PIPE
            self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)
        process = self._process
        assert process.stdin is not None and process.stdout is not None
        end = Timer(PATIENCE, process.kill)
        end.start()
        try:
            print(json.dumps(request), file=process.stdin, flush=True)
            line = process.stdout.readline()
        finally:
            end.cancel()
        assert line, "the browser ended, or took too long"
        found = json.loads(line)
        assert "failed" not in found, found["failed"][-2000:]
        return found


_shared: Browser | None = None


@contextmanager
def one_browser() -> Generator[None]:
    """Visits share a browser and a process of it meanwhile: no start for each, but it is warm."""
    global _shared
    with Browser() as _shared:
        try:
            yield
        finally:
            _shared = None


@contextmanager
def pages(folder: Path, viewer: Path = FOLDER) -> Generator[str]:
    """A server of a viewer and of a folder's scenes; gives its address."""
    with serving(make_app(root_of(folder), viewer=viewer)) as address:
        yield address


def pinhole(camera: Camera) -> str:
    content = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    return json.dumps({**content, "w2c": camera.w2c[:3].ravel().tolist()})


def pixels(found: dict[str, Any]) -> NDArray[np.float64]:
    data = np.frombuffer(base64.b64decode(found["pixels"]), np.uint8)
    return data.reshape(found["height"], found["width"], 4)[..., :3] / 255


def screenshot(path: Path) -> NDArray[np.float64]:
    """A step's `shot`, [H, W, 3] in [0, 1]."""
    return np.asarray(Image.open(path).convert("RGB"), np.float64) / 255


def psnr(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return float(-10 * np.log10(max(1e-12, float(((a - b) ** 2).mean()))))
