"""Where the viewer looks from: the circle, arc and first view that Python writes."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from benchmarks.viewer.browser import MISSING, SIZE, pages, pixels, visit
from gsynopsis.cameras.orbit import (
    Circle,
    circle_text,
    default_lens,
    first_text,
    orbit,
)
from gsynopsis.container import encode
from gsynopsis.model.view_bounds import view_bounds_of, view_bounds_text
from gsynopsis.records import FIRST_NOTE, ORBIT_NOTE, LevelSet, positions
from gsynopsis.records import SEEN_NOTE as SEEN
from gsynopsis.scene.camera import Camera, look_at
from tests.viewer.bright import bright_levels
from tests.viewer.node import needs_node, run_node

UP = np.array([0.0, -1.0, 0.0])
CIRCLE = Circle(np.array([0.1, -0.2, 0.3]), UP, np.array([0.0, 0.0, -1.0]), 2.0, 0.4)
ARCS = [None, (-0.4, 0.2), (1.0, 1.0)]
COUNT = 12
RADIUS = 0.4
"""Of the cameras of a capture from one place."""
FLY = "for (let i = 0; i < 200; i++) viewer().scene.camera.fly(0, 0, -0.1)"


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
    notes = {ORBIT_NOTE: circle_text(replace(CIRCLE, arc=arc)), FIRST_NOTE: first_text(photo)}
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


def wheel(notches: int) -> dict[str, str]:
    """Turn the mouse's wheel, outwards if `notches` are positive."""
    delta = 100 if notches > 0 else -100
    script = (
        "{ const stage = viewer().shadowRoot.querySelector('.stage'); stage.focus();"
        f"for (let i = 0; i < {abs(notches)}; i++) stage.dispatchEvent(new WheelEvent('wheel', "
        f"{{ deltaY: {delta}, ctrlKey: true, bubbles: true, cancelable: true }})); 0 }}"
    )
    return {"name": "_", "script": script}


def hue(found: dict[str, Any]) -> NDArray[np.float64]:
    """The mean colour of what is drawn, [3]."""
    image = pixels(found).reshape(-1, 3)
    return image[image.max(axis=1) > 0.1].mean(axis=0)


@dataclass(frozen=True)
class Capture:
    """A scene whose colours run wild with distance, as trained ones do, and a photo of it."""

    levels: LevelSet
    middle: NDArray[np.float64]
    camera: Camera


def captured() -> Capture:
    levels = bright_levels()
    for level in levels.levels:
        level.networks["color_w1"][:, -1] *= 20
    middle = (levels.shared.lattice * levels.frame.voxel).mean(axis=0)
    w2c = look_at(middle + np.array([0.8, -1.2, -3.9]), middle, UP)
    return Capture(levels, middle, Camera(*SIZE, 210.0, 210.0, 120.0, 80.0, w2c))


def write_file(capture: Capture, folder: Path, *, note: bool) -> Path:
    """Its file, with or without the note on where cameras stood."""
    levels, middle, camera = capture.levels, capture.middle, capture.camera
    arm = camera.position - middle
    flat = arm * [1, 0, 1]
    radius = float(np.linalg.norm(flat))
    circle = Circle(middle, UP, flat / radius, radius, float(arm @ UP))
    meta = {ORBIT_NOTE: circle_text(circle), FIRST_NOTE: first_text(camera)}
    if note:
        eyes = camera.position + 0.1 * np.random.default_rng(1).standard_normal((9, 3))
        x = torch.from_numpy(positions(levels.frame, levels.shared.lattice))
        seen = view_bounds_of(eyes, x, levels.frame.extent)
        meta[SEEN] = view_bounds_text(replace(seen, radius=RADIUS))
    path = folder / f"{note}.gsyn"
    path.write_bytes(encode(replace(levels, meta=meta), "compact"))
    return path


@pytest.mark.skipif(bool(MISSING), reason=f"no {MISSING}: viewer NOT tested in a browser")
def test_colours_hold_24_notches_out_and_the_camera_stays_where_the_scene_does(
    tmp_path: Path,
) -> None:
    capture = captured()
    for note in (False, True):
        write_file(capture, tmp_path, note=note)
    look = "picture(null, null)"
    eye = "viewer().scene.camera.pose.position"
    out: list[dict[str, Any]] = [{"wait": "complete"}, {"name": "near", "script": look}]
    out += [wheel(24), {"name": "far", "script": look}, {"name": "eye", "script": eye}]
    more = [{"press": "KeyF"}, {"name": "whole eye", "script": eye}]
    more += [wheel(-60), {"name": "close", "script": eye}, {"name": "_", "script": FLY}]
    more += [{"name": "flown", "script": eye}]
    found = {}
    with pages(tmp_path) as address:
        for case, steps in {
            "False.gsyn&free": out,
            "True.gsyn&free": out,
            "True.gsyn": [*out, *more],
        }.items():
            url = f"{address}/?noui&content={case}"
            found[case] = visit(url, tmp_path, steps).results
    changes = {
        case: float(np.abs(hue(seen["far"]) - hue(seen["near"])).max())
        for case, seen in found.items()
    }
    assert changes["False.gsyn&free"] > 0.2
    assert max(changes["True.gsyn&free"], changes["True.gsyn"]) < 0.1

    def far(case: str, name: str) -> float:
        return float(np.linalg.norm(np.array(found[case][name]) - capture.middle))

    start = float(np.linalg.norm(capture.camera.position - capture.middle))
    assert far("True.gsyn&free", "eye") == pytest.approx(np.exp(3.6) * start, rel=1e-3)
    most = 1.5 * (start + RADIUS)
    assert far("True.gsyn", "eye") == pytest.approx(most, rel=0.05)
    assert far("True.gsyn", "whole eye") <= most * 1.001
    assert far("True.gsyn", "flown") == pytest.approx(most, rel=0.05)
    assert 0.01 * start < far("True.gsyn", "close") < start
