"""Our object in scenes of three.js and PlayCanvas: as our own picture, beside meshes, refining."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.viewer.browser import MISSING, Visit, pages, pinhole, pixels, psnr, visit
from benchmarks.viewer.node import INSTALLED
from gsynopsis.container import decode
from gsynopsis.container.index import parse_index
from gsynopsis.scene.camera import Camera
from gsynopsis.serve.run import serving
from tests.viewer.bright import LEAST_DB, camera_of
from tests.viewer.engines import MODULES, build, drawn, hosted, loaded
from tests.viewer.unseen import UNSEEN
from tests.viewer.watched import LATE, Watched

pytestmark = pytest.mark.skipif(
    bool(MISSING) or not INSTALLED,
    reason=f"no {MISSING or 'packages'}: engines NOT tested in a browser",
)
Image = NDArray[np.float64]
LEVELS = range(4)
COMPLETE: dict[str, Any] = {"wait": "complete"}
RED = np.array([1.0, 0.0, 0.0])
TURN, SCALE, SHIFT = 0.4, 1.7, np.array([0.3, -0.2, 0.5])
"""Of an object that is put elsewhere: radians around z, a factor, world units."""


@pytest.fixture(scope="module")
def camera(bright: Path) -> Camera:
    return camera_of(decode(bright.read_bytes(), "scene"))


@pytest.fixture(scope="module")
def ours(bright: Path, camera: Camera, tmp_path_factory: pytest.TempPathFactory) -> list[Image]:
    """What our own viewer draws of each level."""
    steps = [COMPLETE]
    steps += [{"name": f"{k}", "script": f"picture({pinhole(camera)}, {k})"} for k in LEVELS]
    with pages(bright) as address:
        found = visit(f"{address}/?noui", tmp_path_factory.mktemp("ours"), steps, init=UNSEEN)
    return [pixels(found.results[f"{k}"]) for k in LEVELS]


def cubes(bright: Path, camera: Camera) -> dict[str, dict[str, Any]]:
    """Red cubes that face the camera: before all splats, in the middle of them, and behind them."""
    levels = decode(bright.read_bytes(), "scene")
    points = levels.shared.lattice * levels.frame.voxel
    turn, shift = camera.w2c[:3, :3], camera.w2c[:3, 3]
    depths = points @ turn[2] + shift[2]
    near, front, far = np.quantile(depths, [0, 0.01, 1]).tolist()
    sizes = {
        "before": (near / 2, near / 10),
        "within": (front, far - near),
        "behind": (2 * far, 20 * far),
    }
    found: dict[str, dict[str, Any]] = {}
    for name, (depth, size) in sizes.items():
        center = turn.T @ (np.array([0, 0, depth + size / 2]) - shift)
        angle = float(np.arcsin(turn[2, 0]))
        found[name] = {"center": center.tolist(), "size": size, "angle": angle, "color": 0xFF0000}
    return found


def moved_step(camera: Camera) -> dict[str, Any]:
    """The object elsewhere, and the camera with it."""
    place = np.eye(4)
    c, s = np.cos(TURN), np.sin(TURN)
    place[:3, :3] = SCALE * np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    place[:3, 3] = SHIFT
    w2c = np.diag([SCALE, SCALE, SCALE, 1.0]) @ camera.w2c @ np.linalg.inv(place)
    where = {"position": SHIFT.tolist(), "rotation": [0, 0, TURN], "scale": SCALE}
    return drawn("moved", replace(camera, w2c=w2c), place=where)


@pytest.fixture(scope="module", params=sorted(MODULES))
def tour(
    request: pytest.FixtureRequest,
    bright: Path,
    camera: Camera,
    tmp_path_factory: pytest.TempPathFactory,
) -> Visit:
    """A scene in an engine's page: while it comes, whole, beside meshes; then files of no scene."""
    folder = tmp_path_factory.mktemp("tour")
    site = build(request.param, folder)
    (site / "bad.gsyn").write_bytes(b"PK" + bright.read_bytes()[2:])
    boxes = cubes(bright, camera)
    app = Watched(bright, held=parse_index(bright.read_bytes(), "scene").levels[0].end)
    with hosted(site) as page, serving(app) as scenes:
        steps = [
            drawn("alone", camera, box=boxes["before"]),
            {"name": "memory before", "script": "memory()"},
            loaded(f"{scenes}/{bright.name}", camera),
            {"wait": "base-ready"},
            drawn("base", camera),
            {"name": "_", "script": f"fetch('{scenes}/go', {{mode: 'no-cors'}}).then(() => 0)"},
            COMPLETE,
            *[drawn(f"{k}", camera, level=k) for k in (3, 2, 1, 0)],
            drawn("white", camera, background=0xFFFFFF),
            *[drawn(name, camera, box=cube) for name, cube in boxes.items()],
            moved_step(camera),
            loaded("bad.gsyn", camera),
            {"wait": "error"},
            loaded("missing.gsyn", camera),
            {"until": "seen.filter(({ name }) => name === 'error').length === 2"},
            {"name": "_", "script": "load(null), 0"},
            drawn("nothing", camera),
            {"name": "memory after", "script": "memory()"},
        ]
        found = visit(page, folder, steps, init=LATE)
    assert not [line for line in found.said if line.startswith("pageerror")]
    return found


def shown(tour: Visit, name: str) -> Image:
    assert tour.results[name]["error"] == 0, "WebGL is content"
    return pixels(tour.results[name])


def test_every_level_looks_as_in_our_own_viewer(tour: Visit, ours: list[Image]) -> None:
    for k in LEVELS:
        assert psnr(shown(tour, f"{k}"), ours[k]) >= LEAST_DB, k
    assert psnr(shown(tour, "0"), shown(tour, "3")) < 20


def test_the_base_is_drawn_while_the_rest_is_under_way(tour: Visit, ours: list[Image]) -> None:
    assert psnr(shown(tour, "base"), ours[0]) >= LEAST_DB
    assert [event["level"] for event in tour.times("level-ready")] == list(LEVELS)
    names = [event["name"] for event in tour.seen]
    assert names[0] == "header" and names.index("base-ready") < names.index("complete")


def test_a_mesh_hides_what_is_behind_it_and_shows_through_what_is_before_it(tour: Visit) -> None:
    black, white = shown(tour, "3"), shown(tour, "white")
    before, within, behind = (shown(tour, name) for name in ("before", "within", "behind"))
    middle = np.s_[75:85, 110:130]
    assert (before[middle] == RED).all()
    assert psnr(before[:20], black[:20]) > 50, "elsewhere nothing changed"
    # A red wall shows as far as the splats let a white background through.
    through = white - black
    assert 0.05 < through.mean() < 0.95
    assert psnr(behind, black + through * RED) > 40
    # A cube among the splats takes the place of those behind its face, and of no others.
    assert psnr(within, black) < 40
    assert psnr(within[middle], before[middle]) < 40


def test_an_object_that_is_turned_moved_and_scaled_looks_as_from_there(
    tour: Visit, ours: list[Image]
) -> None:
    """The camera moves along, so the picture stays."""
    assert psnr(shown(tour, "moved"), ours[3]) >= LEAST_DB


def test_what_is_no_scene_is_said_and_what_is_let_go_leaves_nothing(tour: Visit) -> None:
    said = [event["message"] for event in tour.times("error")]
    assert said[0] == "This is no .gsyn file." and "There is no such file" in said[1]
    assert not shown(tour, "nothing").any()
    assert tour.results["memory before"] == tour.results["memory after"]
