"""The scene in a headset, by an emulator of WebXR (iwer) in place of one."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from benchmarks.viewer.browser import MISSING, pages, pixels, psnr, visit
from benchmarks.viewer.node import SOURCES
from gsynopsis.container import decode
from gsynopsis.model.build import model_from_levels
from gsynopsis.records import LevelSet
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import Camera
from gsynopsis.serve.page import single_page
from tests.viewer.bright import LEAST_DB
from tests.viewer.room import FLOOR

EMULATOR = SOURCES / "node_modules" / "iwer" / "build" / "iwer.min.js"
pytestmark = pytest.mark.skipif(
    bool(MISSING) or not EMULATOR.is_file(),
    reason=f"no {MISSING or 'iwer (npm ci)'}: headsets NOT tested",
)
SIZE = (660, 160)
"""Of the window, which the emulator gives to both eyes, side by side."""
FOV_Y, IPD = 1.2, 0.3
"""Radians, and metres between the eyes: more than people have, so that they see other things."""
WORN = f"""
globalThis.headset = new IWER.XRDevice(IWER.metaQuest3, {{
  stereoEnabled: true, fovy: {FOV_Y}, ipd: {IPD}, visibilityMask: null,
}});
headset.installRuntime({{ forceInstall: true }});
"""
LOOK = """
// What the next frame draws on the canvas, which the emulator shows to the eyes.
globalThis.nextFrame = () => new Promise((done) => {
  const { scene } = viewer();
  const { events, canvas } = scene;
  const { frame } = events;
  events.frame = () => {
    events.frame = frame;
    frame();
    const { width, height } = canvas;
    const pen = new OffscreenCanvas(width, height).getContext("2d");
    pen.fillRect(0, 0, width, height);
    pen.drawImage(canvas, 0, 0);
    done({ width, height, pixels: bytes(pen.getImageData(0, 0, width, height).data) });
  };
  scene.wake();
});
// All is decoded and sorted for where the head is, and faded in; sorting for each frame never ends.
globalThis.followed = async () => {
  const { scene } = viewer();
  const pause = (milliseconds) => new Promise((go) => setTimeout(go, milliseconds));
  scene.settled();
  const { serial } = scene;
  while (scene.panes[0].sortedFor < serial) await pause(50);
  for (let quiet = 0; quiet < 2; quiet++) {
    if (scene.renderer.waits || scene.panes[0].isFading(scene.seconds())) quiet = 0;
    await pause(150);
  }
};
"""
ROOT = "viewer().shadowRoot"
BUTTON = f"{ROOT}.querySelector('[aria-keyshortcuts=V]')"
READY: list[dict[str, Any]] = [{"wait": "complete"}, {"until": f"!!{BUTTON}"}]
THERE = {"until": f"!{BUTTON}.hidden"}
ON, OFF = {"until": "!!viewer().scene.painter"}, {"until": "!viewer().scene.painter"}
STATE = """(({ scene: { camera, caps, canvas }, tools } = viewer()) => ({
  ...camera.pose, up: camera.up, fov: camera.chosenFov, caps: caps.map(String),
  size: [canvas.width, canvas.height], tall: tools.places.tall(viewer().scene),
}))()"""
FOLLOWED = {"name": "_", "script": "followed()"}
SETTLED = {"name": "_", "script": "viewer().scene.settled()"}
NOTE = f"{ROOT}.querySelector('.note').innerText"


def emulated() -> str:
    """Script of a page whose browser has a headset."""
    return EMULATOR.read_text(encoding="utf-8") + WORN + LOOK


@dataclass(frozen=True)
class Wearer:
    """Somebody who put the headset on where the page's camera was: level, looking ahead.

    Attributes:
        axes: To the right, up and back, rows, [3, 3].
        position: World units, [3].
        metre: World units of a metre.
    """

    axes: NDArray[np.float64]
    position: NDArray[np.float64]
    metre: float

    @classmethod
    def at(cls, state: dict[str, Any]) -> "Wearer":
        up = np.array(state["up"], np.float64)
        back = np.cross(state["right"], up)
        back /= np.linalg.norm(back)
        metre = state["tall"] / 1.6 if state["tall"] else state["distance"] / 2
        return cls(np.array([np.cross(up, back), up, back]), np.array(state["position"]), metre)

    def camera(self, place: tuple[float, float, float] = (0, 0, 0), yaw: float = 0.0) -> Camera:
        """Camera at a place of the headset's space, metres, turned to the left, radians."""
        c, s = np.cos(yaw), np.sin(yaw)
        right, up, back = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]) @ self.axes
        w2c = np.eye(4)
        w2c[:3, :3] = right, -up, -back
        w2c[:3, 3] = -w2c[:3, :3] @ (self.position + self.metre * np.array(place) @ self.axes)
        focal = SIZE[1] / 2 / np.tan(FOV_Y / 2)
        return Camera(SIZE[0] // 2, SIZE[1], focal, focal, SIZE[0] / 4, SIZE[1] / 2, w2c)

    def eyes(
        self, place: tuple[float, float, float] = (0, 0, 0), yaw: float = 0.0
    ) -> tuple[Camera, Camera]:
        """Cameras of the left and the right eye of a head."""
        side = IPD / 2 * np.array([np.cos(yaw), 0, -np.sin(yaw)])
        left, right = np.array(place) - side, np.array(place) + side
        return self.camera((*left,), yaw), self.camera((*right,), yaw)


def pair(found: dict[str, Any]) -> list[NDArray[np.float64]]:
    """The pictures of both eyes."""
    image = pixels(found)
    assert image.shape[:2] == SIZE[::-1]
    return [image[:, : SIZE[0] // 2], image[:, SIZE[0] // 2 :]]


def check_eyes(
    found: dict[str, Any], levels: LevelSet, level: int, head: Camera, eyes: tuple[Camera, Camera]
) -> None:
    """Each eye's picture is that of the CPU renderer: decoded for the head, seen by the eye."""
    decoded = model_from_levels(levels).decode(head, level)
    drawn = []
    for camera in eyes:
        with torch.no_grad():
            image = CpuRenderer().render(decoded, camera, torch.zeros(3)).image
        drawn.append(image.clamp(0, 1).numpy().astype(np.float64))
    seen = pair(found)
    for own, other, expected in zip(seen, seen[::-1], drawn, strict=True):
        assert expected.std() > 0.05, "the test scene shows nothing"
        assert psnr(own, expected) >= LEAST_DB
        assert psnr(other, expected) < LEAST_DB - 10, "both eyes see the same"


def test_without_a_headset_there_is_no_button(small: Path, tmp_path: Path) -> None:
    steps: list[dict[str, Any]] = [
        *READY,
        {"press": "v"},
        {"name": "hidden", "script": f"{BUTTON}.hidden && !{BUTTON}.checkVisibility()"},
        {"name": "worn", "script": "viewer().scene.painter"},
        {"name": "told", "script": NOTE},
    ]
    with pages(small) as address:
        found = visit(address, tmp_path, steps, SIZE)
    assert found.results["hidden"] is True and found.results["worn"] is None
    assert found.results["told"] == "" and not found.times("error")


def test_each_eye_has_its_picture_and_leaving_restores(bright: Path, tmp_path: Path) -> None:
    levels = decode(bright.read_bytes(), "scene")
    turned, yaw = (0.2, 0.1, -0.3), 0.2
    turn = (
        f"(headset.position.set(headset.position.x + {turned[0]}, headset.position.y + {turned[1]},"
        f" headset.position.z + {turned[2]}),"
        f" headset.quaternion.set(0, {np.sin(yaw / 2)}, 0, {np.cos(yaw / 2)}), 0)"
    )
    home = "(headset.position.set(0, 1.6, 0), headset.quaternion.set(0, 0, 0, 1), 0)"
    steps: list[dict[str, Any]] = [
        *READY,
        THERE,
        {"name": "_", "script": f"{home}, viewer().setAttribute('split', '1'), 0"},
        SETTLED,
        {"name": "before", "script": STATE},
        {"name": "page", "script": "nextFrame()"},
        {"clickOn": f"{ROOT}.querySelector('.menu')"},
        {"clickOn": BUTTON},
        ON,
        FOLLOWED,
        {"name": "worn", "script": STATE},
        {"name": "eyes", "script": "nextFrame()"},
        {"name": "_", "script": turn},
        {"name": "_", "script": "nextFrame().then(() => 0)"},
        FOLLOWED,
        {"name": "turned", "script": "nextFrame()"},
        {"press": "v"},
        OFF,
        SETTLED,
        {"name": "after", "script": STATE},
        {"name": "page again", "script": "nextFrame()"},
    ]
    with pages(bright) as address:
        visited = visit(address, tmp_path, steps, SIZE, init=emulated())
    found = visited.results
    assert not visited.times("error") and not any("pageerror" in line for line in visited.said)
    wearer = Wearer.at(found["before"])
    assert found["before"]["caps"] == ["3", "1"]
    assert found["worn"]["caps"] == ["3", "null"], "two levels at once are for the page alone"
    check_eyes(found["eyes"], levels, 3, wearer.camera(), wearer.eyes())
    check_eyes(found["turned"], levels, 3, wearer.camera(turned, yaw), wearer.eyes(turned, yaw))
    assert found["after"] == found["before"]
    assert psnr(pixels(found["page"]), pixels(found["page again"])) >= LEAST_DB


def test_what_ends_by_itself_restores_too(bright: Path, tmp_path: Path) -> None:
    steps: list[dict[str, Any]] = [
        *READY,
        THERE,
        {"name": "before", "script": STATE},
        {"press": "v"},
        ON,
        {"name": "_", "script": "headset.activeSession.end().then(() => 0)"},
        OFF,
        {"name": "after", "script": STATE},
        {"press": "v"},
        ON,
        {"name": "_", "script": "(viewer().open('scene.gsyn'), 0)"},
        {"until": "!headset.activeSession && viewer().scene.drawn > 0"},
        {"name": "opened", "script": STATE},
        {"name": "page", "script": "nextFrame()"},
    ]
    with pages(bright) as address:
        visited = visit(address, tmp_path, steps, SIZE, init=emulated())
    found = visited.results
    assert not visited.times("error") and not any("pageerror" in line for line in visited.said)
    assert found["after"] == found["before"] == found["opened"]
    assert pixels(found["page"]).std() > 0.05, "another scene is seen on the page"


def test_a_headset_shows_the_finest_level_within_the_budget(bright: Path, tmp_path: Path) -> None:
    levels = decode(bright.read_bytes(), "scene")
    live = [level.live for level in levels.levels]
    steps: list[dict[str, Any]] = [
        *READY,
        THERE,
        {"name": "before", "script": STATE},
        {"press": "v"},
        ON,
        FOLLOWED,
        {"name": "worn", "script": STATE},
        {"name": "eyes", "script": "nextFrame()"},
        {"name": "splats", "script": "viewer().scene.drawn"},
    ]
    with pages(bright) as address:
        ask = f"{address}/?budget={live[2] - 1}"
        found = visit(ask, tmp_path, steps, SIZE, init=emulated()).results
    assert found["worn"]["caps"] == ["1", "null"]
    assert 0 < found["splats"] <= live[1] < live[2]
    wearer = Wearer.at(found["before"])
    check_eyes(found["eyes"], levels, 1, wearer.camera(), wearer.eyes())


def test_the_stick_walks_over_the_ground(room: Path, tmp_path: Path) -> None:
    start = {"position": [0, FLOOR - 1, -1.5], "target": [0, FLOOR - 0.8, 1.0]}
    push = "headset.controllers.left.updateAxes('thumbstick', {}, {})"
    steps: list[dict[str, Any]] = [
        *READY,
        THERE,
        {"name": "_", "script": f"(viewer().camera = {json.dumps(start)}, 0)"},
        {"press": "v"},
        ON,
        FOLLOWED,
        {"name": "begin", "script": STATE},
        {"name": "_", "script": f"({push.format(0, -1)}, 0)"},
        {"until": "viewer().scene.camera.pose.position[2] > -0.9"},
        {"name": "_", "script": f"({push.format(0, 0)}, 0)"},
        {"sleep": 300},
        {"name": "end", "script": STATE},
        {"sleep": 300},
        {"name": "still", "script": STATE},
    ]
    with pages(room) as address:
        found = visit(f"{address}/?free", tmp_path, steps, SIZE, init=emulated()).results
    begin, end = found["begin"], found["end"]
    assert begin["tall"] == pytest.approx(1.0, abs=0.05)
    assert begin["position"] == pytest.approx(start["position"], abs=0.01)
    assert begin["forward"] == pytest.approx([0, 0, 1], abs=1e-3), "level, whatever was looked at"
    assert end["position"][1] == pytest.approx(FLOOR - 1, abs=0.05), "at the height of the eyes"
    assert end["position"][0] == pytest.approx(0, abs=0.05)
    assert found["still"]["position"] == pytest.approx(end["position"]), "it goes on by itself"


@pytest.mark.parametrize(
    "refusal",
    [
        "navigator.xr.requestSession = () => Promise.reject(new DOMException('nobody wears it'))",
        "globalThis.XRWebGLLayer = class { constructor() { throw new Error('nobody wears it'); } }",
    ],
    ids=["session", "device"],
)
def test_a_headset_that_does_not_start_is_one_line(
    refusal: str, bright: Path, tmp_path: Path
) -> None:
    steps: list[dict[str, Any]] = [
        *READY,
        THERE,
        {"name": "before", "script": STATE},
        {"press": "v"},
        {"until": f"{NOTE}.includes('headset')"},
        {"name": "told", "script": NOTE},
        {"name": "after", "script": STATE},
        {"name": "session", "script": "headset.activeSession ?? null"},
        {"name": "page", "script": "nextFrame()"},
    ]
    with pages(bright) as address:
        found = visit(address, tmp_path, steps, SIZE, init=f"{emulated()}{refusal};")
    assert found.results["told"] == "The headset did not start: nobody wears it"
    assert found.results["after"] == found.results["before"]
    assert found.results["session"] is None
    assert pixels(found.results["page"]).std() > 0.05
    assert not any("pageerror" in line for line in found.said)


def test_a_page_in_one_file_has_it_and_loads_nothing(bright: Path, tmp_path: Path) -> None:
    page = tmp_path / "scene.html"
    page.write_text(single_page(bright.name, bright.read_bytes()), encoding="utf-8")
    loaded = "performance.getEntriesByType('resource').map(({ name }) => name)"
    steps: list[dict[str, Any]] = [
        *READY,
        THERE,
        {"press": "v"},
        ON,
        FOLLOWED,
        {"name": "eyes", "script": "nextFrame()"},
        {"name": "loaded", "script": loaded},
    ]
    found = visit(page.as_uri(), tmp_path, steps, SIZE, init=emulated()).results
    left, right = pair(found["eyes"])
    assert min(left.std(), right.std()) > 0.05 and psnr(left, right) < LEAST_DB - 10
    assert not [name for name in found["loaded"] if not name.startswith(("blob:", "data:"))]
