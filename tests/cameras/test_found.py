"""Cameras of imports see what a person would look at, and figures are what a person sees."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch

from gsynopsis.cameras.found import Search, worths
from gsynopsis.cameras.orbit import first_camera
from gsynopsis.cameras.placement import lens_of, subject_of
from gsynopsis.cameras.sketch import Sketcher, thinned
from gsynopsis.cameras.viewpoints import Viewpoints, for_splats
from gsynopsis.cli import main
from gsynopsis.container import check_file, describe
from gsynopsis.evaluation.metrics import psnr
from gsynopsis.evaluation.protocols import LevelRenderer
from gsynopsis.formats.readers.any import read_splats
from gsynopsis.formats.readers.base import SplatFile
from gsynopsis.jobs.import_splats import Imported, import_splats
from gsynopsis.model.plain import PlainModel
from gsynopsis.model.splats import SplatModel, decoder_of
from gsynopsis.render.cpu import CpuRenderer
from gsynopsis.scene.camera import Camera
from gsynopsis.serve.gallery import blank_card, card_of
from tests.cameras.splat_scenes import (
    SCENES,
    UP,
    WIDTH,
    SplatScene,
    hollow_box,
    park,
    room,
    scaled,
)

CASES = Path(__file__).parents[3] / "shared" / "cases" / "splats"
HONEST = 3.0
"""dB that a file's figures may differ from those of a person's cameras."""
ONE_MAY_STAND_IN = {"room without ceiling", "terrain", "street", "street in kilometres", "tree"}
"""Scenes that are seen from outside, but open: within their boxes there is room for a person."""
ROUND = {"hollow sphere", "opaque specks", "sky dome", "far dome of more splats", "thick shell"}
"""Closed things of radius 1 about the origin, in boxes with free corners."""
NOT_GOOD = "14 of 40 made-up cameras show too little"
ONE = 4.0
"""dB that they may be above that of the first view: one picture, not a mean."""


def found(scene: SplatScene) -> Viewpoints:
    return for_splats(SplatFile((scene.gaussians,), up=UP, up_said=True))


@cache
def found_in(name: str) -> Viewpoints:
    """Found once, for the test of the cameras and that of an import."""
    return found(SCENES[name]())


def imported(scene: SplatScene, out: Path, monkeypatch: pytest.MonkeyPatch) -> Imported:
    given = SplatFile((scene.gaussians,), up=UP, up_said=True)
    monkeypatch.setattr("gsynopsis.jobs.import_splats.read_splats", lambda source: given)
    return import_splats("scene.ply", out, 2, steps=0)


def seen(level: int, model: SplatModel, scene: SplatScene, cameras: list[Camera]) -> float:
    """Mean PSNR of a level against the scene, dB."""
    truth = PlainModel(scene.gaussians, antialiased=False)
    own, given = (LevelRenderer(m, CpuRenderer()) for m in (model, truth))
    with torch.no_grad():
        return float(np.mean([psnr(own.paint(c, level), given.paint(c, 0)) for c in cameras]))


def framed(camera: Camera, scene: SplatScene) -> bool:
    """All that the scene is about is in the picture, but for a corner."""
    means = scene.gaussians.means.astype(float)
    about = ((means >= scene.box[0] - 1e-6) & (means <= scene.box[1] + 1e-6)).all(axis=1)
    return bool(camera.framed(means[about]).which.mean() > 0.99)


@pytest.mark.parametrize("name", SCENES)
def test_cameras_stand_where_a_person_would(name: str) -> None:
    """All of an object in the first view; within a room; far sky and floaters or not."""
    scene = SCENES[name]()
    views = found_in(name)
    assert not views.doubt
    assert len(views.cameras) == 40
    eyes = np.stack([camera.position for camera in views.cameras])
    low, high = scene.box
    # Where nothing is overhead, a little higher is still inside.
    inside = ((eyes > low) & (eyes < high * (1, 1, 1.5))).all(axis=1)
    size = float(np.linalg.norm(high - low))
    if scene.whole:
        inside = inside & (np.linalg.norm(eyes, axis=1) < 1) if name in ROUND else inside
        assert name in ONE_MAY_STAND_IN or not inside.any()
        assert framed(views.cameras[0], scene)
        assert np.linalg.norm(eyes - (low + high) / 2, axis=1).max() < 4 * size
    else:
        assert inside.all()


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_an_import_says_what_a_person_sees(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = SCENES[name]()

    def search(given: SplatFile, up: object, **options: object) -> Viewpoints:
        """An import asks for what the other test looks at."""
        assert len(given.levels) == 1 and given.levels[0] is scene.gaussians
        assert (given.up, given.up_said, up) == (UP, True, None)
        assert options == {"count": 40, "width": WIDTH, "renderer": None}
        return found_in(name)

    monkeypatch.setattr("gsynopsis.jobs.splat_views.for_splats", search)
    # As large as a person's; the sheet of them is not looked at.
    monkeypatch.setattr("gsynopsis.jobs.import_splats.VIEWS_SIDE", WIDTH)
    monkeypatch.setattr("gsynopsis.jobs.splat_views.SHEET_SIDE", 96)
    made = imported(scene, tmp_path / "a.gsyn", monkeypatch)
    levels = check_file(tmp_path / "a.gsyn")
    first, model = first_camera(levels.meta), decoder_of(levels)
    assert first is not None
    assert isinstance(model, SplatModel)
    assert len(made.psnr) == 2
    for level, said in enumerate(made.psnr):
        assert said == pytest.approx(seen(level, model, scene, scene.cameras()), abs=HONEST)
        assert said < seen(level, model, scene, [first]) + ONE


def test_a_scene_that_no_camera_sees_has_no_db_and_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """All of it is nearer than the near plane of every renderer."""
    out = tmp_path / "a.gsyn"
    made = imported(scaled(hollow_box(), 1e-4), out, monkeypatch)
    assert made.psnr == ()
    cameras, note = made.notes
    assert "no cameras were given" in cameras
    assert "no dB: 40 of 40 made-up cameras" in note
    info = describe(out)
    assert [level.quality for level in info.levels] == [{}, {}]
    assert "40 of 40" in info.meta["protocol"]
    assert main(["info", str(out)]) == 0
    assert "psnr" not in capsys.readouterr().out
    ends = tuple(level.bytes for level in info.levels)
    card = card_of(blank_card("a.gsyn", out), out)
    assert card.levels == tuple((end, None) for end in ends)


@pytest.mark.parametrize("name", ["floaters", "hollow_object"])
def test_the_examples_are_seen_whole_and_from_near(name: str) -> None:
    path = CASES / name / "scene.ply"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    given = read_splats(path)
    finest = given.levels[-1]
    views = for_splats(given)
    first = views.cameras[0]
    near = finest.means[np.linalg.norm(finest.means, axis=1) < 10].astype(float)
    assert not views.doubt
    assert first.framed(near).which.mean() > 0.99
    assert np.linalg.norm(first.position) < 10


@pytest.mark.parametrize("good", [27, 26])
def test_more_than_a_third_of_bad_cameras_is_a_doubt(
    good: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Search, "chosen", lambda self, tries, count: list(range(good)))
    monkeypatch.setattr("gsynopsis.cameras.found.AGAIN", ())
    views = found(hollow_box())
    assert len(views.cameras) == good
    assert views.doubt == ("" if good == 27 else f"{NOT_GOOD} (too near, or nothing)")


@pytest.mark.parametrize("name", ["room", "park"])
def test_the_first_view_of_what_no_frame_holds_is_the_best(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The best by itself, whichever adds most to what the others see."""
    gaussians = room().gaussians if name == "room" else park()
    subject = subject_of(gaussians, UP)
    renderer = CpuRenderer()
    search = Search(subject, Sketcher(thinned(gaussians), subject, renderer), lens_of(WIDTH))
    monkeypatch.setattr(Search, "_whole", lambda self, tries, worth: np.zeros(len(tries), bool))
    tries = search.tries()
    rows = search.chosen(tries, 12)[::-1]
    first, *others = search.best_first(tries, rows)
    worth = worths(tries)
    assert worth[first] == worth[rows].max()
    assert others == [row for row in rows if row != first]
