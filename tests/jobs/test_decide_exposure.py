"""`train.exposure auto` is decided once, before the first step, and says why."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import gsynopsis as gs
from gsynopsis.errors import SettingError
from gsynopsis.jobs import decide_exposure as exposure
from gsynopsis.jobs.decide_exposure import NAME, decide_exposure
from gsynopsis.jobs.options import RunOptions
from gsynopsis.jobs.train_run import make_context
from gsynopsis.runs.folder import read_record
from gsynopsis.synthetic.make_scene import make_scene
from gsynopsis.training.fork import Fork
from gsynopsis.training.observer import Silent

STEPS = {"train.steps": 20, "levels.steps": 20}


class Told(Silent):
    """Keeps messages."""

    def __init__(self) -> None:
        self.messages = list[str]()

    def on_message(self, text: str) -> None:
        self.messages.append(text)


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> Path:
    """A room of 24 photos."""
    out = tmp_path_factory.mktemp("plain") / "room"
    return make_scene("room", out, views=24, width=96, height=64, points=800)


@pytest.fixture(scope="module")
def gained(plain, tmp_path_factory) -> Path:
    """The same, each photo with a gain of its own; every eighth, held out, as it was."""
    folder = Path(shutil.copytree(plain, tmp_path_factory.mktemp("gained") / "room"))
    rng = np.random.default_rng(2)
    for number, path in enumerate(sorted((folder / "images").iterdir())):
        if number % 8:
            with Image.open(path) as photo:
                pixels = np.asarray(photo) * rng.uniform(0.5, 1.15) * rng.uniform(0.9, 1.1, 3)
            Image.fromarray(np.rint(pixels.clip(0, 255)).astype(np.uint8)).save(path)
    return folder


def decided(scene: gs.Scene, asked: dict[str, object]) -> tuple[str, str]:
    context = make_context(scene, gs.resolve("standard", scene, asked).config, RunOptions())
    return decide_exposure(context, Silent(), lambda: False)


def test_large_gains_are_found_and_proven(gained) -> None:
    value, reason = decided(gs.load_scene(gained), {"train.steps": 600})
    assert value == "on", reason
    assert "held-back photos" in reason and reason.count("dB") == 1


def test_it_is_off_where_photos_do_not_differ_where_steps_are_few_and_for_batches(
    plain, gained
) -> None:
    value, reason = decided(gs.load_scene(plain), {})
    assert value == "off" and "differ" in reason
    value, reason = decided(gs.load_scene(gained), STEPS)
    assert value == "off" and "too few photos or steps" in reason
    value, reason = decided(gs.load_scene(gained), {"train.batch": 2})
    assert value == "off" and "one view" in reason


@pytest.mark.parametrize(
    ("off", "on", "value"),
    [
        ((20.0, 20.0, 20.0), (20.2, 20.3, 20.2), "on"),
        ((20.0, 20.0, 20.0), (20.05, 20.1, 20.0), "off"),
        ((20.0, 20.0, 20.0), (21.5, 19.6, 19.6), "off"),  # one photo of three says it all
        ((20.0, 20.0, 20.0), (19.0, 19.5, 19.0), "off"),
    ],
)
def test_held_back_photos_decide(gained, monkeypatch, off, on, value) -> None:
    monkeypatch.setattr(exposure, "fork_exposure", lambda *given: Fork(off, on))
    found, reason = decided(gs.load_scene(gained), {})
    assert found == value
    assert f"{np.mean(on):.2f} dB with it, {np.mean(off):.2f} without" in reason


def test_a_training_says_and_records_the_decision_and_goes_on_with_it(
    gained, tmp_path, monkeypatch
) -> None:
    monkeypatch.setattr(exposure, "fork_exposure", lambda *given: Fork((20.0,) * 3, (21.0,) * 3))
    scene, told = gs.load_scene(gained), Told()
    recipe = gs.resolve("standard", scene, STEPS)
    assert recipe.config.train.exposure == "auto", "not decided without its photos"
    options = {"photo_pixels": 0}
    gs.train(scene, recipe, tmp_path / "run", told, **options)
    for name in ("metrics.json", "report.html"):
        assert "21.00 dB with it, 20.00 without" in (tmp_path / "run" / name).read_text("utf-8")
    assert sum(NAME in line for line in told.messages) == 1
    record = read_record(tmp_path / "run")
    assert record.config is not None and record.config["train"]["exposure"] == "on"
    assert "21.00 dB with it, 20.00 without" in record.followed[NAME]

    def undecided(*given: object) -> Fork:
        raise AssertionError("a run that was begun is not decided again")

    monkeypatch.setattr(exposure, "exposure_evidence", undecided)
    gs.train(scene, recipe, tmp_path / "run", Told(), evaluate=False, **options)
    assert read_record(tmp_path / "run").followed[NAME] == record.followed[NAME]


def test_what_is_asked_for_is_done_and_batches_are_refused(gained) -> None:
    scene = gs.load_scene(gained)
    for value in ("on", "off"):
        recipe = gs.resolve("standard", scene, {NAME: value})
        assert recipe.config.train.exposure == value
    with pytest.raises(SettingError, match="batch 1"):
        gs.resolve("standard", scene, {NAME: "on", "train.batch": 2})


def test_the_preset_of_the_paper_has_none() -> None:
    assert gs.resolve("paper").config.train.exposure == "off"
