"""Suites are checked before anything is trained."""

from pathlib import Path

import pytest

from gsynopsis.errors import InputError, SettingError
from research.suites.suite import read_suite
from research.suites.validation_scenes import PROCEDURAL

GOOD = '[scenes.a]\npath = "procedural:tiny"\n[methods.ours]\n'
SUITES = Path(__file__).parents[3] / "suites"


def written(folder: Path, text: str) -> Path:
    path = folder / "suite.toml"
    path.write_text(text)
    return path


UNFOLDS = '[methods.b]\nunfolds = "plain"\n'
OURS = UNFOLDS.replace("plain", "ours")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("seeds = [", "a suite in TOML"),
        ("", "required field `scenes`"),
        ("seedz = [0]\n" + GOOD, "unknown field `seedz`"),
        (GOOD.replace("tiny", "moon"), f"found moon, expected {' or '.join(PROCEDURAL)}"),
        (GOOD.replace("procedural:tiny", "nowhere"), "scenes.a.path: found no folder"),
        (GOOD + 'preset = "fastest"', "preset: found invalid enum value 'fastest'"),
        (GOOD + "set = { train.stepz = 3 }", "methods.ours"),
        (GOOD + 'set = { train.steps = "many" }', "methods.ours"),
        (GOOD + 'baseline = { name = "quadtree" }', "baseline.name: found invalid enum value"),
        (GOOD + 'baseline = { name = "gode", rates = 0 }', "baseline.rates: found expected"),
        (GOOD + 'baseline = { name = "gode", rate = 1 }', "unknown field `rate`"),
        ("anchor = 'plain'\n" + GOOD, "anchor: found plain, expected ours"),
        ("seeds = [1, 1]\n" + GOOD, "different seeds"),
        (GOOD.replace("[methods.ours]", '[methods."../up"]'), "methods: found '../up'"),
        (GOOD.replace("[methods.ours]", "[methods]"), "methods: found none"),
        (GOOD + UNFOLDS, "methods.b.unfolds: found plain, expected ours"),
        (GOOD + UNFOLDS.replace("plain", "b"), "methods.b.unfolds: found b, expected ours"),
        (GOOD + OURS + 'preset = "paper"', "methods.b: found paper, expected what ours has"),
        (GOOD + OURS + 'baseline.name = "gode"', "methods.b: found a baseline, expected what ours"),
        (GOOD + OURS + "set.train.steps = 7", "methods.b: found a change of the full model"),
    ],
)
def test_what_is_no_suite_is_one_clear_line(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(SettingError) as caught:
        read_suite(written(tmp_path, text))
    assert told in str(caught.value)
    assert "suite.toml" in str(caught.value)


def test_cells_are_all_combinations_with_seeds_outermost(tmp_path: Path) -> None:
    more = '[scenes.b]\npath = "procedural:few"\nscale = 2\nsplit = "validation"\n'
    text = "seeds = [3, 4]\n" + GOOD + "[methods.two.set]\ntrain.growth.cell = 8\n" + more
    suite = read_suite(written(tmp_path, text))
    assert [cell.stem for cell in suite.cells[:4]] == ["a-ours-3", "a-two-3", "b-ours-3", "b-two-3"]
    assert len({cell.name for cell in suite.cells}) == 8
    asked = {"train.growth.cell": 8, "scale": 2.0, "split": "validation", "train.seed": 4}
    assert suite.cells[-1].asked == asked
    assert suite.anchor == "ours"


def test_a_method_that_unfolds_has_the_settings_of_the_full_model_but_for_levels(
    tmp_path: Path,
) -> None:
    scene = "[scenes.a.set]\ntrain.steps = 5\n"  # what a method sets wins, of its levels too
    text = scene + GOOD + 'preset = "paper"\nset = { train.steps = 7, levels.steps = 8 }\n'
    more = OURS + 'set.levels.ablation = "lad"\n[methods.alone]\npreset = "paper"\n'
    alone = 'set = { train.steps = 7, levels = { steps = 8, ablation = "lad" } }\n'
    ours, unfolds, trained = read_suite(written(tmp_path, text + more + alone)).cells
    assert (unfolds.unfolds, ours.unfolds, trained.unfolds) == (ours, None, None)
    assert unfolds.asked == trained.asked
    assert unfolds.name.removeprefix("a-b-0") == trained.name.removeprefix("a-alone-0")


def test_other_settings_are_another_cell_and_the_same_in_other_words_are_not(
    tmp_path: Path,
) -> None:
    one, same, other = (
        read_suite(written(tmp_path, GOOD + line)).cells[0]
        for line in ("set.train.steps = 7", 'set = { "train.steps" = 7 }', "set.train.steps = 8")
    )
    assert one.name == same.name != other.name
    assert one.stem == other.stem


def test_scenes_have_folders_of_photos_widths_and_settings_of_their_own(tmp_path: Path) -> None:
    (tmp_path / "data" / "garden").mkdir(parents=True)
    text = (
        '[scenes.garden]\npath = "garden"\nimages = "images_4"\nmax_width = 1600\n'
        "set = { model.voxel = 0.5, train.steps = 7 }\n"
        "[methods.one]\n[methods.two]\nset = { model.voxel = 0 }\n"
    )
    one, two = read_suite(written(tmp_path, text), tmp_path / "data").cells
    assert (one.images, one.max_width) == ("images_4", 1600)
    assert one.asked["model.voxel"] == 0.5 and two.asked["model.voxel"] == 0
    assert one.asked["train.steps"] == two.asked["train.steps"] == 7
    plain = text.replace('images = "images_4"\n', "").replace("max_width = 1600\n", "")
    assert read_suite(written(tmp_path, plain), tmp_path / "data").cells[0].name != one.name


def test_scenes_can_be_chosen_and_a_missing_one_says_what_to_do(tmp_path: Path) -> None:
    text = GOOD + '[scenes.b]\npath = "far/away"\n'
    path = written(tmp_path, text)
    with pytest.raises(SettingError, match="with --only which to take"):
        read_suite(path)
    assert [cell.scene for cell in read_suite(path, only=("a",)).cells] == ["a"]
    with pytest.raises(SettingError, match="--only: found 'c', expected a or b"):
        read_suite(path, only=("c",))


def test_seeds_can_be_chosen(tmp_path: Path) -> None:
    path = written(tmp_path, "seeds = [0, 3]\n" + GOOD)
    seeds = [cell.seed for cell in read_suite(path).cells]
    last = seeds[-1]
    assert len({*seeds}) > 1
    assert {cell.seed for cell in read_suite(path, seeds=(last,)).cells} == {last}
    with pytest.raises(SettingError, match="--seeds: found 99, expected 0 or 3"):
        read_suite(path, seeds=(last, 99))


STANDARD = {
    "360_v2": ("bicycle flowers garden stump treehill bonsai counter kitchen room", "every8", 1600),
    "tandt": ("train truck", "every8", 0),
    "db": ("drjohnson playroom", "every8", 0),
    "bungeenerf": ("amsterdam bilbao hollywood pompidou quebec rome", "bungee", 1600),
}


def test_the_standard_suite_has_the_data_sets_as_they_are_published(tmp_path: Path) -> None:
    for folder, (names, _, _) in STANDARD.items():
        for name in names.split():
            (tmp_path / folder / name).mkdir(parents=True)
    cells = read_suite(SUITES / "standard.toml", tmp_path).cells
    assert len(cells) == 19 * 12 * 3
    for cell in cells:
        folder = Path(cell.path).parent.name
        names, split, width = STANDARD[folder]
        assert cell.scene in names.split()
        assert (cell.asked["split"], cell.max_width) == (split, width)
    voxels = {
        Path(c.path).parent.name: c.asked.get("model.voxel") for c in cells if c.method == "paper"
    }
    assert voxels == {"360_v2": 0.001, "tandt": 0.01, "db": 0.005, "bungeenerf": None}


@pytest.mark.parametrize("path", sorted(SUITES.glob("*.toml")), ids=lambda path: path.name)
def test_the_suites_of_the_repository_can_be_read(path: Path, tmp_path: Path) -> None:
    """Real scenes are no part of the repository; folders of their names stand for them."""
    for name in ("fox", "brighton", "bonsai", "alexander"):
        (tmp_path / name).mkdir()
    for folder, (names, _, _) in STANDARD.items():
        for name in names.split():
            (tmp_path / folder / name).mkdir(parents=True)
    assert len(read_suite(path, tmp_path).cells) > 1


DEEP = "x" + ".x" * 1500


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (GOOD + f"[methods.ours.set]\n{DEEP} = 1", "methods.ours.set: found more than 8 tables"),
        (GOOD + f"[methods.ours.set.{DEEP}]\ny = 1", "methods.ours.set: found more than 8"),
        (f"{GOOD}[scenes.a.set]\n{DEEP} = 1", "scenes.a.set: found more than 8 tables"),
        (
            GOOD.replace("procedural:tiny", "a\\u0000b"),
            "path: found expected `a name`, got `a NUL`",
        ),
        (f'{GOOD}[scenes.b]\npath = "."\nimages = "a\\u0000"', "images: found expected `a name`"),
        (GOOD + "set = { levels.mode = [1] }", "methods.ours: found --levels"),
        (GOOD + "set = { levels = 3 }", "methods.ours"),
        (GOOD.replace("tiny", "y" * 900_000), "scenes.a.path: found yyy"),
        (GOOD.replace("[methods.ours]", "scale = 1e308\n[methods.ours]"), "found 1e\\+308"),
        ("#" * 2_000_000 + GOOD, "expected at most 1,048,576"),
    ],
)
def test_hostile_suites_are_one_short_line(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(InputError, match=told) as error:
        read_suite(written(tmp_path, text))
    assert len(str(error.value)) < 1200
