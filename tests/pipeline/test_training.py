"""The road as functions: what a training leaves, whatever comes after it."""

from pathlib import Path

import pytest

import gsynopsis as gs
from gsynopsis.config import Recipe
from gsynopsis.container import check_file, describe
from gsynopsis.errors import DivergedError, SettingError
from gsynopsis.pipeline import packing
from gsynopsis.pipeline.training import Conduct, resolve, unfolded
from gsynopsis.training.progress import Silent

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
    recipe = resolve("fast", scene, SMALL)
    run = gs.train(scene, recipe, tmp_path, heard, conduct=Conduct(evaluate=False))
    assert len(check_file(run.file).levels) == 4
    assert not describe(run.file).levels[3].quality
    assert [text for text in heard.said if "could not be measured: a rendered image" in text]


def test_a_recipe_follows_the_split_of_its_scene(scene: gs.Scene) -> None:
    assert resolve("fast", scene).config.split == "every8"
    with pytest.raises(SettingError, match="split: found a scene split by every8"):
        resolve("fast", scene, {"split": "none"})


def test_other_levels_have_the_settings_of_their_preset_and_no_other_model() -> None:
    config = resolve("fast", 50, {"levels.keep": [0.5, 0.5]}).config
    found: Recipe = unfolded(config, {"levels.mode": "sequential"}, "fast")
    assert found.config.levels.mode == "sequential" and found.config.levels.keep == (0.5, 0.5)
    assert found.config.model == config.model
    former = unfolded(config, {"levels.faint_share": 0.1}, "fast")
    assert former.notes == ("levels.faint_share is called levels.prune_share now",)
    assert getattr(former.config.levels, "prune_share", None) == 0.1
    with pytest.raises(SettingError, match="a change of the full model"):
        unfolded(config, {"model.slots": 3}, "fast")
