"""What was asked for always wins; what follows the scene is continuous, and says why."""

import json
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsynopsis.config import (
    PRESETS,
    Sequential,
    preset_of,
    resolve_settings,
    values_of,
)
from gsynopsis.config.serialize import ALL_NAMES, get, names_of
from gsynopsis.errors import SettingError

OURS = ("standard", "max")
OTHERS: dict[str, list[Any]] = {
    "scale": [2.0, 3.5],
    "split": ["none", "validation"],
    "model.feature": ["synopsis", "free"],
    "model.fusion": ["mlp", "none"],
    "model.slots": [1, 10, 16],
    "model.grids": [0, 4, 12],
    "model.table_log2": [6, 13, 15],
    "model.codebook": [0, 16, 256],
    "model.residual": [1, 12],
    "model.hidden": [8, 32, 48],
    "model.opacity_init_scale": [1.0, 2.0, 4.0],
    "model.bounds": ["contract", "aabb"],
    "model.voxel": [0.0, 0.25],
    "train.steps": [1, 300, 1500, 40_000],
    "train.seed": [0, 7],
    "train.batch": [1, 4],
    "train.rates": ["paper", "ours"],
    "train.opacity_weight": [0.0, 0.01],
    "train.weight_average": [0.0, 0.15],
    "train.exposure": ["auto", "on", "off"],
    "train.subpixel_jitter": [1, 2],
    "train.dropout": [0.0, 0.3],
    "train.reduced_until": [[], [0.5], [0.3, 0.6]],
    "train.growth.cell": [16, 40],
    "train.growth.per_pixel": [0.0, 1.3],
    "train.growth.every": [10, 100],
    "train.growth.until": [0.5, 0.7],
    "train.growth.threshold": [2e-4, 3.5e-5, 0.0],
    "train.growth.grow_visits": [0.1, 0.4],
    "train.growth.prune_visits": [0.4, 0.8],
    "train.growth.max_anchors": [100, 1_000_000],
    "levels.keep": [[0.5], [0.7, 0.5, 0.4], []],
    "levels.steps": [1, 2500, 10_000],
    "levels.level_mib": [[0.2, 0.4, 0.7, 1.0], []],
    "levels.prune_share": [0.0, 0.0036, 0.1],
    "levels.levels_per_step": [1.0, 2.5, 3],
    "levels.loss_weights": [[], [0.6, 0.8, 1.1]],
    "levels.weights": ["tied", "separate"],
    "levels.coding_loss": [0.0, 0.1, 1.0],
    "levels.selection": ["controller", "lambda"],
    "levels.sparsity": [[2e-3, 4e-3, 8e-3], [0.1]],
    "levels.group_weight": [0.01, 3.0],
    "levels.ablation": ["full", "lad"],
    "levels.resolution": ["own", "full"],
}
"""Values that may be asked for, the presets' own among them."""


def test_there_is_a_value_to_ask_for_of_every_setting() -> None:
    assert sorted(OTHERS) == sorted(set(ALL_NAMES) - {"levels.mode"})


def test_there_are_at_most_45_settings() -> None:
    assert len(ALL_NAMES) <= 45


@st.composite
def asked(draw: st.DrawFn) -> dict[str, Any]:
    mode = draw(st.sampled_from(["joint", "sequential"]))
    names = draw(st.sets(st.sampled_from(sorted(set(names_of(mode)) - {"levels.mode"}))))
    found: dict[str, Any] = {"levels.mode": mode}
    found |= {name: draw(st.sampled_from(OTHERS[name])) for name in sorted(names)}
    if found.get("levels.level_mib"):
        found["levels.keep"] = [0.7, 0.5, 0.4]
    if not found.get("model.grids", 1) and not found.get("model.codebook", 1):
        found.setdefault("model.residual", 12)  # there have to be some features
    return found


@settings(max_examples=400, deadline=None)
@given(preset=st.sampled_from(sorted(PRESETS)), views=st.integers(2, 300), wanted=asked())
def test_what_was_asked_for_always_wins(preset: str, views: int, wanted: dict[str, Any]) -> None:
    recipe = resolve_settings(preset, views, wanted)
    values: Any = values_of(recipe.config)
    for name, value in wanted.items():
        inner = values
        for key in name.split("."):
            inner = inner[key]
        assert inner == value, name
        assert recipe.source(name) == "asked for"
    assert not recipe.asked & set(recipe.followed)


FOLLOWING = ("model.slots", "train.growth.cell", "levels.steps")
"""Whole numbers that follow the photos."""


@settings(max_examples=200, deadline=None)
@given(preset=st.sampled_from(sorted(PRESETS)), views=st.integers(2, 299), wanted=asked())
def test_one_photo_more_changes_a_little(preset: str, views: int, wanted: dict[str, Any]) -> None:
    one, more = (resolve_settings(preset, n, wanted).config for n in (views, views + 1))
    for name in names_of(one.levels.mode):
        before, after = get(one, name), get(more, name)
        if isinstance(before, float) or name in FOLLOWING:
            # A fifth, or the next whole number; of a share that begins at nothing, 2 %.
            least = {"train.dropout": 0.02}.get(name, 1.0 * isinstance(before, int))
            assert abs(after - before) <= max(0.2 * abs(before), least) + 1e-9
        elif name == "levels.loss_weights":
            assert len(before) == len(after)
            pairs = zip(before, after, strict=True)
            assert all(abs(b - a) <= 0.2 * a for a, b in pairs), name
        else:
            assert before == after, name


def test_every_single_setting_can_be_asked_for_at_the_presets_own_value() -> None:
    for preset in PRESETS:
        usual = preset_of(preset)
        for levels in (usual.joint, usual.sequential):
            base = {"levels.mode": levels.mode}
            for name in names_of(levels.mode):
                start = resolve_settings(preset, None, base).config
                value = get(start, name)
                given = list(value) if isinstance(value, tuple) else value
                few = resolve_settings(preset, 5, {**base, name: given})
                assert get(few.config, name) == value, name


def test_nothing_follows_the_scene_in_the_paper_s_preset() -> None:
    assert resolve_settings("paper", 3).config == resolve_settings("paper", 300).config
    assert not resolve_settings("paper", 3).followed


@pytest.mark.parametrize("preset", ["standard", "max"])
def test_the_lattice_is_as_fine_as_the_photos_pixels_unless_asked_for(preset: str) -> None:
    recipe = resolve_settings(preset, 60, cell=0.02)
    assert recipe.config.model.voxel == 0.02
    assert recipe.source("model.voxel") == "the size of the photos' pixels"
    asked = resolve_settings(preset, 60, {"model.voxel": 0}, cell=0.02)
    assert asked.config.model.voxel == 0 and asked.source("model.voxel") == "asked for"
    assert resolve_settings("paper", 60, cell=0.02).config.model.voxel == 0


def test_steps_of_levels_follow_those_of_the_full_model_unless_asked_for() -> None:
    assert resolve_settings("paper", None, {"train.steps": 3000}).config.levels.steps == 1000
    given = {"train.steps": 3000, "levels.steps": 10_000}
    assert resolve_settings("paper", None, given).config.levels.steps == 10_000


def test_as_many_levels_as_sizes_are_ordered() -> None:
    two = resolve_settings("standard", 50, {"levels.level_mib": [0.1, 0.3]})
    assert two.config.levels.count == 2 and "levels.keep" in two.followed
    with pytest.raises(SettingError, match="--level-mib: found"):
        resolve_settings(
            "standard", 50, {"levels.level_mib": [0.1, 0.3], "levels.keep": [0.5, 0.5]}
        )


def test_a_recipe_says_where_each_value_comes_from() -> None:
    recipe = resolve_settings("standard", 30, {"train.steps": 1000, "model.hidden": 24})
    assert recipe.source("model.hidden") == "asked for"
    assert recipe.source("model.bounds") == "preset standard"
    assert recipe.source("train.growth.threshold") == "30 photos, 2,667 steps"
    assert any(line.startswith("train.growth.threshold ") for line in recipe.lines())
    with pytest.raises(SettingError, match="no such setting"):
        recipe.source("model.x")


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"levels.mode": "foo"}, "--levels: found 'foo', expected joint or sequential"),
        ({"levels.weights": "x"}, "--levels.weights: found 'x', expected tied or separate"),
        ({"model.bounds": "foo"}, "--model.bounds: found 'foo', expected contract or aabb"),
        ({"train.rates": "foo"}, "--train.rates: found 'foo', expected paper or ours"),
        ({"levels.sparsity": [1]}, "it is a setting of sequential levels"),
        ({"levels.mode": "sequential", "levels.prune_share": 0}, "it is a setting of joint levels"),
        ({"model.x": 1}, "--model.x: found no such setting, expected feature"),
        ({"model": 3}, "--model: found"),
        ({"x.y": 3}, "--x.y: found no such setting"),
    ],
)
def test_what_cannot_be_is_refused_by_name(given: dict[str, Any], expected: str) -> None:
    with pytest.raises(SettingError) as caught:
        resolve_settings("standard", 50, given)
    assert expected in str(caught.value)


def test_there_is_no_such_preset() -> None:
    with pytest.raises(SettingError, match="--preset: found best"):
        resolve_settings("best")


def test_recipes_are_plain_to_see_in_a_notebook() -> None:
    text = resolve_settings("standard", 20)._repr_markdown_()
    assert text.startswith("**standard**") and "\n| `train.growth.threshold` |" in text
    assert math.isfinite(len(json.dumps(text)))


def test_the_papers_preset_selects_by_lambda_and_threshold_and_ratios_are_an_option() -> None:
    levels = resolve_settings("paper", 43, {}).config.levels
    assert isinstance(levels, Sequential) and levels.selection == "lambda"
    levels = resolve_settings("paper", 43, {"levels.selection": "controller"}).config.levels
    assert isinstance(levels, Sequential) and levels.keep == (0.7, 0.5, 0.4)
