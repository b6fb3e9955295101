"""The package for npm: what is in it, and an app that is built with it."""

import json
import re
import shutil
import subprocess
import tarfile
from pathlib import Path

import pytest

from benchmarks.viewer.browser import MISSING, pinhole, pixels, psnr, visit
from benchmarks.viewer.node import INSTALLED, SOURCES, npx, standalone
from gsynopsis import __version__
from gsynopsis.container import decode
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.run import serving
from tests.viewer.bright import LEAST_DB, camera_of, drawn_by_cpu

NPM = shutil.which("npm")
pytestmark = pytest.mark.skipif(
    not (INSTALLED and NPM), reason="npm or viewer/node_modules is not there: package NOT tested"
)
MAIN = """
import "gsynopsis-viewer";
import type { ViewerCamera, ViewerElement, ViewerEventMap, ViewerEvents } from "gsynopsis-viewer";

const viewer: ViewerElement = document.createElement("gsynopsis-viewer");
viewer.setAttribute("noui", "");
viewer.setAttribute("src", "scene.gsyn");
viewer.style.cssText = "position: absolute; inset: 0";
viewer.addEventListener("level-ready", ({ detail }) => {
  document.title = `level ${detail.level.toFixed(0)}`;
});
// What docs/viewer.md says of the element, in types.
document.querySelector("gsynopsis-viewer")?.addEventListener("viewer-error", function (event) {
  const { trouble, message }: ViewerEvents["viewer-error"] = event.detail;
  const sizes = this.levels.map(({ bytes, psnr }) => bytes + (psnr ?? 0));
  console.log(trouble.length, message.length, sizes);
});
window.addEventListener("complete", ({ detail }) => { console.log(detail.bytes, detail.seconds); });
const moved = ({ detail }: ViewerEventMap["camera-change"]) => { console.log(detail.position[0]); };
viewer.addEventListener("camera-change", moved);
viewer.removeEventListener("camera-change", moved);
viewer.addEventListener("click", (event) => { console.log(event.clientX); });
viewer.addEventListener("something", (event) => { console.log(event.type); });
export async function tour(wanted: Partial<ViewerCamera>): Promise<Blob> {
  viewer.camera = { ...wanted, position: [0, 0, 1] };
  viewer.first();
  viewer.whole();
  viewer.next(-1);
  viewer.help();
  console.log(viewer.camera?.fov, viewer.stats.fps, viewer.open(new Blob()));
  return viewer.picture();
}
// @ts-expect-error: there is no such figure
viewer.addEventListener("complete", ({ detail }) => { console.log(detail.nothing); });
document.body.append(viewer);
"""
TYPES = {
    "compilerOptions": {
        "target": "ES2022", "module": "ESNext", "moduleResolution": "bundler", "strict": True,
        "lib": ["ES2022", "DOM", "DOM.Iterable"], "types": [], "noEmit": True,
    },
    "include": ["main.ts"],
}  # fmt: skip


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What npm would publish, unpacked."""
    folder = tmp_path_factory.mktemp("npm")
    # A copy, since tests run side by side.
    sources = folder / "viewer"
    apart = shutil.ignore_patterns("node_modules", "dist", "LICENSE")
    shutil.copytree(SOURCES, sources, ignore=apart)
    (sources / "node_modules").symlink_to(SOURCES / "node_modules")
    shutil.copy(SOURCES.parent / "LICENSE", folder)
    line = [str(NPM), "pack", "--pack-destination", str(folder), "--loglevel", "error"]
    done = subprocess.run(line, cwd=sources, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    (archive,) = folder.glob("*.tgz")
    assert archive.name == f"gsynopsis-viewer-{__version__}.tgz"
    with tarfile.open(archive) as content:
        # Python 3.11 has the argument `filter`, and what it does, from 3.11.4 on only.
        content.extraction_filter = getattr(tarfile, "data_filter", None)
        content.extractall(folder)
    return folder / "package"


def test_the_package_holds_the_viewer_its_types_and_its_licence(package: Path) -> None:
    names = {path.relative_to(package).as_posix() for path in package.rglob("*") if path.is_file()}
    modules = {f"dist/gsynopsis-{name}.js" for name in ("viewer", "element", "worker")}
    assert {"package.json", "README.md", "LICENSE", *modules} <= names
    strange = {n for n in names if not re.fullmatch(r"[^/]+|dist/(types/([\w-]+/)*)?[\w.-]+", n)}
    assert not strange
    assert (package / "dist/gsynopsis-viewer.js").read_bytes() == standalone().read_bytes()
    about = json.loads((package / "package.json").read_text())
    assert "dependencies" not in about
    for place in (about["types"], *about["exports"]["."].values()):
        assert (package / place).is_file(), place


def kernel() -> str:
    """The beginning of the decoder's WebAssembly, as text."""
    found = re.search(
        r'"([\w+/]{64})', (SOURCES / "src" / "decode" / "kernel" / "wasm.gen.ts").read_text()
    )
    assert found
    return found[1]


@pytest.mark.skipif(bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser")
def test_an_app_built_with_it_shows_the_scene(package: Path, bright: Path, tmp_path: Path) -> None:
    app = tmp_path / "app"
    app.mkdir()
    (app / "package.json").write_text('{"private": true, "type": "module"}')
    (archive,) = package.parent.glob("*.tgz")
    line = [str(NPM), "install", "--offline", "--no-audit", "--no-fund", str(archive)]
    done = subprocess.run(line, cwd=app, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    assert json.loads((app / "package.json").read_text())["dependencies"]
    (app / "main.ts").write_text(MAIN)
    page = '<!doctype html><body><script type="module" src="/main.ts"></script>'
    (app / "index.html").write_text(page)
    (app / "tsconfig.json").write_text(json.dumps(TYPES))
    npx("tsc", "-p", str(app))
    npx("vite", "build", str(app), "--logLevel", "warn")
    built = app / "dist"
    scripts = [path.read_text() for path in built.glob("assets/*.js")]
    assert len(list(built.glob("assets/gsynopsis-worker-*.js"))) == 1, "the worker's script"
    for part in (kernel(), "#version 300 es"):
        assert sum(part in script for script in scripts) == 1, "a part is shipped twice"
    assert sum(map(len, scripts)) < 1.1 * standalone().stat().st_size
    shutil.copy(bright, built / "scene.gsyn")
    levels = decode(bright.read_bytes(), "scene")
    camera = camera_of(levels)
    look = {"name": "picture", "script": f"picture({pinhole(camera)}, 3)"}
    steps = [{"wait": "complete"}, look, {"name": "title", "script": "document.title"}]
    with serving(make_app(root_of(built), viewer=built)) as address:
        found = visit(address, tmp_path, steps)
    assert found.results["title"] == "level 3"
    assert psnr(pixels(found.results["picture"]), drawn_by_cpu(levels, camera)[3]) >= LEAST_DB
    assert not [line for line in found.said if line.startswith("pageerror")]
