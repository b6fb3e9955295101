"""The decoder as a module without a page."""

import json
from pathlib import Path

import numpy as np
import torch

from benchmarks.viewer.node import npx
from gsynopsis.container import decode
from gsynopsis.model.build import model_from_levels
from tests.viewer.node import needs_node, run_node
from tests.viewer.test_decoder import everywhere

pytestmark = needs_node
EYE = [0.5, -0.2, -1.0]


def test_its_sources_need_no_page() -> None:
    """They are typed against a worker's world, which has neither document nor elements."""
    npx("tsc", "-p", "tsconfig.headless.json")


def test_node_gets_the_gaussians_of_the_model_and_the_same_refusals(
    bright: Path, tmp_path: Path
) -> None:
    npx("vite", "build", "--mode", "headless", "--outDir", str(tmp_path), "--logLevel", "warn")
    bad = tmp_path / "bad.gsyn"
    changed = bytearray(bright.read_bytes())
    changed[-9] ^= 4
    bad.write_bytes(changed)
    module = tmp_path / "gsynopsis-headless.js"
    found = json.loads(run_node("headless.mjs", module, bright, bad, 1, json.dumps(EYE)))
    assert found["page"] == "undefined"
    assert found["refusal"] == "ChecksumError"
    assert [event for event in found["events"] if event.startswith("level ")] == [
        f"level {k}" for k in range(4)
    ]
    model = model_from_levels(decode(bright.read_bytes(), "scene"))
    with torch.no_grad():
        expected = everywhere(model, model.part(1), np.array(EYE)).gaussians
    opaque = expected.opacities >= 1 / 255
    assert opaque.sum() > 100
    for name in ("means", "scales", "quats", "opacities", "colors"):
        ours = np.array(found["arrays"][name]).reshape(int(opaque.sum()), -1)
        theirs = getattr(expected, name)[opaque].numpy().reshape(len(ours), -1)
        # The order is that of the file's slots on one side, of anchors on the other.
        assert np.allclose(np.sort(ours, axis=0), np.sort(theirs, axis=0), atol=1e-3), name
