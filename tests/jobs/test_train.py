"""The road as functions: what a training leaves, whatever comes after it."""

from pathlib import Path

import numpy as np
import pytest

import gsynopsis as gs
from gsynopsis.config import Recipe
from gsynopsis.container import check_file, describe
from gsynopsis.errors import DivergedError, SceneError, SettingError
from gsynopsis.jobs import write_file as packing
from gsynopsis.jobs.resolve import resolve, unfolded
from gsynopsis.jobs.train import posed_scene
from gsynopsis.jobs.write_file import Packing
from gsynopsis.scene.masks import MaskUse
from gsynopsis.scene.programs import find
from gsynopsis.scene.scene import SceneOptions
from gsynopsis.training.distributed.process_group import init_process_group
from gsynopsis.training.observer import Silent

SMALL = {"train.steps": 6, "model.slots": 3, "model.hidden": 8}


class Heard(Silent):
    """Keeps what is said."""

    def __init__(self) -> None:
        self.said = list[str]()

    def on_message(self, text: str) -> None:
        self.said.append(text)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> gs.Scene:
    out = tmp_path_factory.mktemp("scenes") / "room"
    return gs.load_scene(gs.make_scene("room", out, views=9, width=32, height=24, points=150))


def test_a_training_whose_result_cannot_be_measured_still_leaves_its_file(
    scene: gs.Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*arguments: object) -> None:
        raise DivergedError("a rendered image holds values that are not finite")

    monkeypatch.setattr(packing, "measure_quality", fails)
    heard = Heard()
    recipe = resolve("standard", scene, SMALL)
    run = gs.train(scene, recipe, tmp_path, heard, evaluate=False)
    assert len(check_file(run.file).levels) == 4
    assert not describe(run.file).levels[3].quality
    assert [text for text in heard.said if "could not be measured: a rendered image" in text]


def test_a_recipe_follows_the_split_of_its_scene(scene: gs.Scene) -> None:
    assert resolve("standard", scene).config.split == "every8"
    with pytest.raises(SettingError, match="split: found a scene split by every8"):
        resolve("standard", scene, {"split": "none"})


def test_other_levels_have_the_settings_of_their_preset_and_no_other_model() -> None:
    config = resolve("standard", 50, {"levels.keep": [0.5, 0.5]}).config
    found: Recipe = unfolded(config, {"levels.mode": "sequential"}, "standard")
    assert found.config.levels.mode == "sequential" and found.config.levels.keep == (0.5, 0.5)
    assert found.config.model == config.model
    with pytest.raises(SettingError, match="a change of the full model"):
        unfolded(config, {"model.slots": 3}, "standard")


@pytest.fixture(scope="module")
def trained(scene: gs.Scene, tmp_path_factory: pytest.TempPathFactory) -> gs.Run:
    out = tmp_path_factory.mktemp("runs") / "room"
    return gs.train(scene, resolve("standard", scene, SMALL), out, evaluate=False)


def test_a_crop_box_leaves_out_what_lies_outside_of_it(trained: gs.Run, tmp_path: Path) -> None:
    with gs.open(trained.file) as whole:
        means = whole.gaussians().means
        middle = np.median(means, axis=0)
        before = {tuple(mean) for mean in means.tolist()}
    box = (*middle.tolist(), *(means.max(axis=0) + 1).tolist())
    path = gs.pack(trained, tmp_path / "cropped.gsyn", crop=box)
    with gs.open(path) as file:
        kept = file.gaussians().means
        assert 0 < len(kept) < len(means) / 2
        assert (kept >= middle - 1e-3).all()
        assert len(file.levels) == 4 and path.stat().st_size < trained.file.stat().st_size
    inside = [mean for mean in before if (np.array(mean) >= middle + 1e-3).all()]
    # What the file's first view does not show is not listed.
    assert len(kept) >= 0.5 * len(inside)
    assert gs.pack(trained, tmp_path / "again.gsyn").read_bytes() == trained.file.read_bytes()


def test_a_box_that_cannot_be_is_refused_with_where_the_scene_is(
    trained: gs.Run, tmp_path: Path
) -> None:
    with pytest.raises(SettingError, match="--crop: found 0 0 0 1 0 1, expected x y z of the low"):
        Packing(crop=(0, 0, 0, 1, 0, 1))
    with pytest.raises(SettingError, match=r"a box with nothing in it, expected part of -?\d"):
        gs.pack(trained, tmp_path / "far.gsyn", crop=(900, 900, 900, 901, 901, 901))
    assert not (tmp_path / "far.gsyn").exists()


def test_up_is_as_asked_and_the_circle_turns_around_it(trained: gs.Run, tmp_path: Path) -> None:
    path = gs.pack(trained, tmp_path / "tilted.gsyn", up=(0.0, 3.0, 4.0))
    with gs.open(path) as file:
        assert file.meta["up"] == "0 0.6 0.8"
        places = np.stack([camera.position for camera in file.orbit(12, all_round=True)])
    flat = (places - places.mean(axis=0)) @ np.array([0, 0.6, 0.8])
    assert np.abs(flat).max() < 0.01 * np.ptp(places, axis=0).max()
    for up in ((0.0, 0.0, 0.0), (0.0, float("nan"), 1.0)):
        with pytest.raises(SettingError, match="--up: found"):
            Packing(up=up)


@pytest.mark.parametrize("masks", ["loss", "empty", "alpha"])
def test_masks_that_are_asked_for_and_not_there_end_before_training(
    masks: MaskUse, scene: gs.Scene, tmp_path: Path
) -> None:
    with pytest.raises(SceneError, match=f"masks: found none, expected .*--masks {masks}"):
        gs.train(scene.root, "standard", tmp_path / "run", Heard(), masks=masks)
    assert not (tmp_path / "run").exists()


def test_poses_of_another_program_are_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before it was read once to know whether there are poses, and then again."""
    from benchmarks.robust.ways import metashape, new_mixture, write_photos

    mixture = new_mixture(np.random.default_rng(0), "digits")
    write_photos(mixture, tmp_path)
    metashape(mixture, tmp_path)
    count, read = [0], find.read_metashape

    def counted(path: Path) -> object:
        count[0] += 1
        return read(path)

    monkeypatch.setattr(find, "read_metashape", counted)
    reading = SceneOptions()
    with init_process_group() as group:
        found = posed_scene(tmp_path, tmp_path / "run", "every8", reading, group, Heard())
    assert len(found.views) == len(mixture.names) and count == [1]
