"""Suites are checked before anything is trained."""

from pathlib import Path

import pytest

from gsynopsis.bench.suite import read_suite
from gsynopsis.errors import SettingError
from gsynopsis.scene.procedural import PROCEDURAL

GOOD = '[scenes.a]\npath = "procedural:tiny"\n[methods.ours]\n'
SUITES = Path(__file__).parents[2] / "suites"


def written(folder: Path, text: str) -> Path:
    path = folder / "suite.toml"
    path.write_text(text)
    return path


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


def test_other_settings_are_another_cell_and_the_same_in_other_words_are_not(
    tmp_path: Path,
) -> None:
    one, same, other = (
        read_suite(written(tmp_path, GOOD + line)).cells[0]
        for line in ("set.train.steps = 7", 'set = { "train.steps" = 7 }', "set.train.steps = 8")
    )
    assert one.name == same.name != other.name
    assert one.stem == other.stem


@pytest.mark.parametrize("path", sorted(SUITES.glob("*.toml")), ids=lambda path: path.name)
def test_the_suites_of_the_repository_can_be_read(path: Path, tmp_path: Path) -> None:
    """Real scenes are no part of the repository; folders of their names stand for them."""
    for name in ("fox", "brighton", "bonsai", "alexander"):
        (tmp_path / "shared" / "data" / name).mkdir(parents=True)
    copy = tmp_path / "gsynopsis" / "suites" / path.name
    copy.parent.mkdir(parents=True)
    copy.write_text(path.read_text())
    assert len(read_suite(copy).cells) > 1
