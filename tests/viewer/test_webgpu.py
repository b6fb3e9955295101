"""The viewer by WebGPU: the pictures of WebGL 2, and what it does where the device is not there."""

from pathlib import Path
from typing import Any

import pytest

from benchmarks.viewer.browser import MISSING, pages, pinhole, pixels, psnr, visit
from gsynopsis.container import decode
from tests.viewer.bright import LEAST_DB, camera_of, drawn_by_cpu

pytestmark = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser"
)
ALIKE_DB = 45.0
WEBGPU = {"webgpu": True}
API = "viewer().scene.renderer.api ?? 'WebGL 2'"


def test_every_level_looks_as_by_webgl(bright: Path, tmp_path: Path) -> None:
    levels = decode(bright.read_bytes(), "scene")
    camera = camera_of(levels)
    steps: list[dict[str, Any]] = [{"wait": "complete"}, {"name": "api", "script": API}]
    steps += [{"name": f"L{k}", "script": f"picture({pinhole(camera)}, {k})"} for k in (0, 1, 2, 3)]
    steps.append({"name": "again", "script": f"picture({pinhole(camera)}, 0)"})
    with pages(bright) as address:
        webgl = visit(f"{address}/?noui", tmp_path, steps)
        webgpu = visit(f"{address}/?noui&renderer=webgpu", tmp_path, steps, context=WEBGPU)
    assert (webgl.results["api"], webgpu.results["api"]) == ("WebGL 2", "WebGPU")
    for k, expected in enumerate(drawn_by_cpu(levels, camera)):
        ours = pixels(webgpu.results[f"L{k}"])
        assert psnr(ours, pixels(webgl.results[f"L{k}"])) >= ALIKE_DB
        assert psnr(ours, expected) >= LEAST_DB
    assert webgpu.results["again"] == webgpu.results["L0"]
    assert not webgpu.times("error") and not webgpu.said
