"""Where the viewer looks from: the circle, arc and first view that Python writes."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsynopsis.cli.orbit import (
    FIRST,
    META,
    Circle,
    circle_text,
    default_lens,
    first_text,
    look_at,
    orbit,
)
from gsynopsis.pack import encode
from gsynopsis.scene.camera import Camera
from tests.viewer.bright import bright_levels
from tests.viewer.browser import MISSING, pages, visit
from tests.viewer.node import needs_node, run_node

CIRCLE = Circle(
    np.array([0.1, -0.2, 0.3]), np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, -1.0]), 2.0, 0.4
)
ARCS = [None, (-0.4, 0.2), (1.0, 1.0)]
COUNT = 12


@needs_node
@pytest.mark.parametrize("arc", ARCS)
def test_the_viewer_orbits_as_python_does(arc: tuple[float, float] | None) -> None:
    circle = replace(CIRCLE, arc=arc)
    turns = json.dumps([k / COUNT for k in range(COUNT)])
    poses = json.loads(run_node("viewpoints.mjs", circle_text(circle), turns))
    for pose, camera in zip(poses, orbit(circle, default_lens(), COUNT), strict=True):
        assert np.allclose(pose["position"], camera.position, atol=1e-6)
        assert np.allclose(pose["forward"], camera.forward, atol=1e-6)


@needs_node
@pytest.mark.parametrize("arc", ["[1]", "[1,0]", "3", "null"])
def test_the_viewer_refuses_the_arcs_that_python_refuses(arc: str) -> None:
    text = circle_text(CIRCLE)[:-1] + f',"arc":{arc}}}'
    assert run_node("viewpoints.mjs", text, "[0]") == "null"


@pytest.mark.skipif(bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser")
def test_the_first_view_and_home_are_a_photo_s_pose_and_steps_stay_on_the_arc(
    tmp_path: Path,
) -> None:
    roll = np.eye(4)
    roll[:2, :2] = [[0.8, -0.6], [0.6, 0.8]]
    w2c = roll @ look_at(np.array([0.5, -0.3, -2.0]), CIRCLE.target, CIRCLE.up)
    photo = Camera(300, 200, 400.0, 400.0, 150.0, 100.0, w2c)
    arc = (-0.5, 0.3)
    notes = {META: circle_text(replace(CIRCLE, arc=arc)), FIRST: first_text(photo)}
    levels = bright_levels()
    file = tmp_path / "scene.gsyn"
    file.write_bytes(encode(replace(levels, meta=notes), "compact"))
    pinhole = {"name": "first", "script": "viewer().scene.pinhole()"}
    pose = "viewer().scene.camera.pose.position"
    focus = {"name": "_", "script": "viewer().shadowRoot.querySelector('.stage').focus()"}
    steps = [{"wait": "complete"}, pinhole, focus]
    for k in range(8):
        steps += [{"press": "BracketRight"}, {"name": f"{k}", "script": pose}]
    steps += [{"press": "KeyF"}, {"press": "Home"}, {**pinhole, "name": "home"}]
    with pages(file) as address:
        found = visit(f"{address}/?noui", tmp_path, steps).results
    assert found["home"] == found["first"]
    assert np.allclose(np.reshape(found["first"]["w2c"], (3, 4)), w2c[:3], atol=1e-5)
    # The page is as wide as the photo: 240 × 160 against 300 × 200 pixels.
    assert found["first"]["fx"] == pytest.approx(400 * 160 / 200, rel=1e-5)
    eyes = np.array([found[f"{k}"] for k in range(7)]) - CIRCLE.target
    side = np.cross(CIRCLE.up, CIRCLE.ahead)
    angles = np.arctan2(eyes @ side, eyes @ CIRCLE.ahead)
    expected = [0.1, 0.3, 0.1, -0.1, -0.3, -0.5, -0.3]
    assert angles == pytest.approx(expected, abs=1e-5)
    assert np.allclose(found["7"], photo.position, atol=1e-5)
