"""Pages of three.js and PlayCanvas, with our object for them as npm would have it."""

import json
import shutil
from collections.abc import Generator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

from benchmarks.viewer.browser import pinhole
from benchmarks.viewer.node import SOURCES, npx
from gsynopsis.scene.camera import Camera
from tests.viewer.node import HERE

PACKAGES = SOURCES / "node_modules"
MODULES = {
    "three": [PACKAGES / "three/build" / f"three.{part}.js" for part in ("module", "core")],
    "playcanvas": [PACKAGES / "playcanvas/build/playcanvas.min.mjs"],
}
PAGE = """<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,">
<body style="margin: 0"><canvas></canvas>
<script type="importmap">{{"imports": {{"{engine}": "./{module}"}}}}</script>
<script type="module" src="{engine}.js"></script>"""


def build(engine: str, folder: Path) -> Path:
    """A folder with a page of an engine: the engine, our object for it, and the worker's script."""
    site = folder / engine
    for mode in (engine, "worker"):
        keep = ("--emptyOutDir", "false", "--logLevel", "warn")
        npx("vite", "build", "--mode", mode, "--outDir", str(site), *keep)
    for path in (*MODULES[engine], *(HERE / "pages").iterdir()):
        # Hosts know the type of `.js`, not that of `.mjs`.
        shutil.copy(path, site / path.with_suffix(".js").name)
    page = PAGE.format(engine=engine, module=MODULES[engine][0].with_suffix(".js").name)
    (site / "index.html").write_text(page)
    return site


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        pass


@contextmanager
def hosted(site: Path) -> Generator[str]:
    """A plain host of a page's files; gives its address."""
    host = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(site)))
    Thread(target=host.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{host.server_port}"
    finally:
        host.shutdown()
        host.server_close()


def drawn(name: str, camera: Camera, **what: Any) -> dict[str, Any]:
    """A step of a visit: a camera's picture, under a name."""
    return {"name": name, "script": f"draw({pinhole(camera)}, {json.dumps(what)}).then(packed)"}


def loaded(address: str, camera: Camera, **options: Any) -> dict[str, Any]:
    """A step of a visit: a file is loaded, and seen by a camera."""
    words = ", ".join((json.dumps(address), json.dumps(options), pinhole(camera)))
    return {"name": "_", "script": f"load({words}), 0"}
