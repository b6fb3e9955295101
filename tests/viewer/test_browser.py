"""The viewer in real Chromium: what it shows, when, and what it says of trouble."""

import base64
import json
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from gsynopsis.model.build import model_from_levels
from gsynopsis.pack import decode, encode
from gsynopsis.records import LevelSet
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import Camera
from gsynopsis.serve.app import make_app
from gsynopsis.serve.files import root_of
from gsynopsis.serve.run import serving
from gsynopsis.stream.virtual import Link
from tests.level_sets import Shape, make_level_set
from tests.viewer.node import HERE, NODE, VIEWER

PACKAGES = HERE.parent.parent / "viewer" / "package.json"
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)  # fmt: skip
MISSING = [
    name
    for name, there in (
        ("node", NODE),
        ("Chromium", CHROMIUM),
        ("viewer/node_modules (npm ci)", (PACKAGES.parent / "node_modules/playwright-core").is_dir()),
    )
    if not there
]
pytestmark = pytest.mark.skipif(bool(MISSING), reason=f"viewer NOT tested in a browser: no {', '.join(MISSING)}")  # fmt: skip

SHAPE = Shape(
    anchors=(150, 400, 900, 1800), slots=5, grids=(2, 3, 4, 4), features=4, entries=16,
    code_width=8, hidden=16,
)  # fmt: skip
SIZE = (240, 160)
LEAST_DB = 35.0


@dataclass(frozen=True)
class Visit:
    """What a visit to the page gave."""

    results: dict[str, Any]
    seen: list[dict[str, Any]]
    said: list[str]

    def names(self) -> list[str]:
        return [event["name"] for event in self.seen]


@dataclass(frozen=True)
class Asked:
    """A visit to be made."""

    steps: Sequence[dict[str, Any]]
    query: str = "&plain"
    link: Link | None = None
    content: str = ""
    touch: bool = False
    pages: Path = field(default=VIEWER.parent)


def visit(file: Path, folder: Path, asked: Asked) -> Visit:
    """Serve a file, open its page, take the steps."""
    app = make_app(root_of(file), viewer=asked.pages, link=asked.link)
    with serving(app) as address:
        content = asked.content or file.name
        request = {
            "packages": str(PACKAGES),
            "chromium": CHROMIUM,
            "url": f"{address}/?content={content}&noui{asked.query}",
            "width": SIZE[0],
            "height": SIZE[1],
            "touch": asked.touch,
            "steps": list(asked.steps),
            "out": str(folder),
        }
        path = folder / "visit.json"
        path.write_text(json.dumps(request))
        command = [str(NODE), str(HERE / "browser.mjs"), str(VIEWER), str(path)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=180)
    assert done.returncode == 0, done.stderr[-2000:]
    results = json.loads(done.stdout)
    return Visit(results, results.pop("seen"), results.pop("said"))


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "scene.gsyn"
    path.write_bytes(encode(bright_levels(), "compact"))
    return path


def bright_levels() -> LevelSet:
    """A random level set whose Gaussians are large, opaque and colourful."""
    rng = np.random.default_rng(3)
    levels = make_level_set(rng, SHAPE)
    levels.shared.log_scales[:, 3:] += 1.5
    for level in levels.levels:
        level.networks["opacity_b2"][:] += 0.7
        level.networks["color_b2"][:] = 2 * rng.standard_normal(3 * SHAPE.slots)
    return levels


def camera_of(levels: LevelSet) -> Camera:
    """In front of the anchors, a little turned."""
    points = levels.shared.lattice * levels.frame.voxel
    w2c = np.eye(4)
    angle = 0.3
    w2c[:3, :3] = [[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]]
    middle = points.mean(axis=0)
    w2c[:3, 3] = -w2c[:3, :3] @ middle + [0, 0, 1.3 * np.ptp(points, axis=0).max()]
    return Camera(*SIZE, 210.0, 205.0, 118.0, 83.0, w2c)


def pinhole(camera: Camera) -> str:
    content = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    return json.dumps({**content, "w2c": camera.w2c[:3].ravel().tolist()})


def pixels(found: dict[str, Any]) -> NDArray[np.float64]:
    data = np.frombuffer(base64.b64decode(found["pixels"]), np.uint8)
    return data.reshape(found["height"], found["width"], 4)[..., :3] / 255


def psnr(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return float(-10 * np.log10(max(1e-12, float(((a - b) ** 2).mean()))))


def test_every_level_looks_as_the_cpu_renderer_draws_it(file: Path, tmp_path: Path) -> None:
    levels = decode(file.read_bytes(), "scene")
    camera = camera_of(levels)
    names = [f"L{k}" for k in range(len(levels.levels))]
    shots = [
        {"name": name, "script": f"picture({pinhole(camera)}, {k})"} for k, name in enumerate(names)
    ]
    # Down again: what was refined must not show in the coarse level.
    again = {"name": "again", "script": f"picture({pinhole(camera)}, 0)"}
    found = visit(file, tmp_path, Asked([{"wait": "complete"}, *shots, again], query=""))
    model = model_from_levels(levels)
    pictures = []
    for k, name in enumerate(names):
        with torch.no_grad():
            drawn = CpuRenderer().render(model.decode(camera, k), camera, torch.zeros(3)).image
        expected = drawn.clamp(0, 1).numpy().astype(np.float64)
        assert expected.std() > 0.05, "the test scene shows nothing"
        pictures.append(expected)
        assert psnr(pixels(found.results[name]), expected) >= LEAST_DB, name
    assert psnr(pixels(found.results["again"]), pictures[0]) >= LEAST_DB
    assert psnr(pictures[0], pictures[3]) < LEAST_DB, "levels of the test scene look the same"
    assert found.results["L3"]["pixels"] != found.results["L0"]["pixels"]
