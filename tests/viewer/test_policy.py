"""The viewer's estimates and views against the Python ones they are ported from."""

import json
from pathlib import Path

import numpy as np
import pytest

from gsynopsis.stream.fetch import Sample
from gsynopsis.stream.policy import estimate
from gsynopsis.stream.views import Eye, shares
from tests.viewer.node import needs_node, run_node

pytestmark = needs_node


def test_throughput_and_shares_are_those_of_the_policies(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    runs = [
        [(int(rng.integers(1, 10**6)), float(rng.uniform(0.05, 3))) for _ in range(count)]
        for count in (0, 1, 7, 40)
    ]
    low = rng.uniform(-5, 4, (30, 3))
    high = low + rng.uniform(0.01, 3, (30, 3))
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    w2c = np.eye(4)
    w2c[:3, :3], w2c[:3, 3] = turn * np.sign(np.linalg.det(turn)), rng.uniform(-1, 1, 3)
    request = {
        "samples": [[{"amount": a, "seconds": s} for a, s in run] for run in runs],
        "boxes": np.hstack([low, high]).tolist(),
        "eye": {"w2c": w2c[:3].ravel().tolist(), "position": [0, 0, 0], "right": 0.7, "up": 0.5},
    }
    path = tmp_path / "request.json"
    path.write_text(json.dumps(request))
    found = json.loads(run_node("policy.mjs", path))
    for run, rate in zip(runs, found["rates"], strict=True):
        samples = [Sample(amount, seconds) for amount, seconds in run]
        assert rate == pytest.approx(estimate(samples), rel=1e-9)
    expected = shares(low, high, Eye(w2c, 0.7, 0.5))
    assert 0 < np.count_nonzero(expected) < 30
    assert np.allclose(found["shares"], expected, rtol=1e-9, atol=1e-12)


def test_what_is_seen_comes_first_and_parents_before_children(tmp_path: Path) -> None:
    path = tmp_path / "request.json"
    path.write_text(json.dumps({"samples": [], "boxes": [], "eye": None, "choices": True}))
    found = json.loads(run_node("policy.mjs", path))["choices"]
    # Blocks 1/1 and its children 2/2, 2/3 are seen; the rest of the scene is behind the camera.
    assert found == ["1/1", "2/3", "2/2", "1/0", "2/0", "2/1"]
