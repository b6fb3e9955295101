"""Each rule by which settings follow a scene and the steps: both ends, and even between them."""

from itertools import pairwise
from typing import Any

import pytest

from gsynopsis.config import (
    Config,
    Joint,
    preset_of,
    resolve_settings,
    total_steps,
)
from gsynopsis.config.scene_rules import (
    FEW_VIEWS,
    FINE_EXPONENT,
    FINE_PASSES,
    FINEST,
    FINEST_CELL,
    GROWING_STEPS,
    MANY_POINTS,
    MANY_VIEWS,
    PASS_EXPONENT,
    PASSES,
    SHORTEST,
    USUAL_STEPS,
)
from gsynopsis.config.serialize import get

OURS = ("standard", "max")


def joint(config: Config) -> Joint:
    assert isinstance(config.levels, Joint)
    return config.levels


@pytest.mark.parametrize("preset", OURS)
def test_every_photo_more_from_2_to_300_changes_a_little(preset: str) -> None:
    """All counts, where the test above draws some: 16 photos had 68 % more growth than 15."""
    names = ("train.growth.until", "train.growth.threshold", "levels.levels_per_step")
    configs = [resolve_settings(preset, views).config for views in range(2, 300)]
    for one, more in pairwise(configs):
        for name in names:
            assert abs(get(more, name) - get(one, name)) <= 0.2 * get(one, name)


def test_many_photos_leave_the_time_to_the_finest_level() -> None:
    found = {views: resolve_settings("standard", views).config.levels for views in (71, 97, 250)}
    assert all(isinstance(levels, Joint) for levels in found.values())
    together = {views: levels.levels_per_step for views, levels in found.items()}  # type: ignore[union-attr]
    assert together[71] == 3 and 2 < together[97] < 3 and together[250] == 2
    steps = {views: levels.steps for views, levels in found.items()}
    assert steps[71] == 2_500 < steps[97] < steps[250] == 3_200
    short = resolve_settings("standard", 43, {"train.steps": 60}).config.levels
    assert isinstance(short, Joint) and short.levels_per_step == 3
    asked = resolve_settings("standard", 250, {"levels.levels_per_step": 3}).config.levels
    assert isinstance(asked, Joint) and asked.levels_per_step == 3


@pytest.mark.parametrize("views", [43, 89, 252])
def test_a_quality_is_so_many_steps_and_nothing_else(views: int) -> None:
    standard = preset_of("standard").config
    assert total_steps(standard) == USUAL_STEPS
    for quality in ("draft", "high", "max"):
        steps = preset_of(quality).config.train.steps
        asked = resolve_settings("standard", views, {"train.steps": steps}).config
        assert resolve_settings(quality, views).config == asked


def test_large_photos_begin_reduced_and_how_long_is_continuous() -> None:
    def reduced(side: float, preset: str = "standard", **asked: Any) -> tuple[float, ...]:
        return resolve_settings(preset, 60, asked, side=side).config.train.reduced_until

    assert reduced(0) == reduced(384) == reduced(4000, "paper") == ()
    assert reduced(512) == reduced(4000) == reduced(800, "max") == (0.3, 0.6)
    for side in range(256, 520):
        now, later = ((*reduced(size), 0, 0)[:2] for size in (side, side + 1))
        assert now[1] == pytest.approx(2 * now[0])
        assert 0 <= later[1] - now[1] < 0.01
    assert reduced(800, **{"train.reduced_until": [0.5]}) == (0.5,)
    assert reduced(800, **{"levels.mode": "sequential"}) == ()
    source = resolve_settings("standard", 60, side=533).source("train.reduced_until")
    assert source == "60 photos, 533 pixels across"


def test_many_large_photos_have_more_steps_unless_steps_are_asked_for() -> None:
    def steps(views: int, side: float, preset: str = "standard", **asked: Any) -> tuple[int, int]:
        config = resolve_settings(preset, views, asked, side=side).config
        return config.train.steps, config.levels.steps

    assert steps(252, 256) == (1_500, 3_200) and steps(71, 800) == (1_500, 2_500)
    full, joint = steps(252, 533)
    assert full == 2_025 and 1.35 * 2_500 < joint < 1.35 * 3_200
    assert steps(252, 533, **{"train.steps": 1_500}) == steps(252, 256)
    assert steps(252, 533, **{"levels.steps": 60}) == (1_500, 60)
    assert steps(252, 533, "max") == steps(252, 0, "max")
    assert steps(252, 533, **{"train.batch": 4})[0] == 1_500  # four photos a step are many passes
    assert steps(252, 533, **{"levels.mode": "sequential"})[0] == 1_500
    for views in range(20, 300):
        assert 0 <= steps(views + 1, 533)[0] - steps(views, 533)[0] < 60
        assert 0 <= steps(250, views + 237)[0] - steps(250, views + 236)[0] < 20
    recipe = resolve_settings("standard", 252, side=533)
    assert recipe.source("train.steps") == "252 photos, 533 pixels across"


def test_few_photos_do_not_begin_reduced() -> None:
    found = [resolve_settings("standard", views, side=800).config.train for views in range(2, 42)]
    ends = [train.reduced_until[1] if train.reduced_until else 0.0 for train in found]
    assert ends[: FEW_VIEWS - 1] == [0.0] * (FEW_VIEWS - 1) and ends[-1] == 0.6
    assert all(0 <= later - now < 0.05 for now, later in pairwise(ends))


@pytest.mark.parametrize("preset", OURS)
def test_few_photos_grow_less_and_many_are_the_preset(preset: str) -> None:
    usual = preset_of(preset).config
    many = resolve_settings(preset, MANY_VIEWS, {"train.steps": usual.train.steps}).config
    assert (many.model, many.train.growth) == (usual.model, usual.train.growth)
    few = resolve_settings(preset, FEW_VIEWS)
    assert few.config.model.slots == 10 and few.config.model.opacity_init_scale == 2.0
    growth = few.config.train.growth
    assert growth.cell == 16 and growth.threshold == pytest.approx(2e-4)
    assert growth.until == pytest.approx(0.15) and few.config.train.dropout == 0.3
    assert many.train.dropout == 0
    assert resolve_settings(preset, 2).config.model == few.config.model


@pytest.mark.parametrize("preset", OURS)
def test_values_are_quantised_less_where_photos_are_seen_often(preset: str) -> None:
    usual = joint(preset_of(preset).config).coding_loss
    steps = FINE_PASSES * MANY_VIEWS
    wanted = {"train.steps": steps, "levels.steps": steps}
    assert joint(resolve_settings(preset, 2 * MANY_VIEWS, wanted).config).coding_loss == usual
    fine = joint(resolve_settings(preset, MANY_VIEWS, wanted).config).coding_loss
    assert fine == pytest.approx(max(FINEST, usual / 2**FINE_EXPONENT))
    often = {"train.steps": 50 * steps, "levels.steps": steps}
    assert joint(resolve_settings(preset, MANY_VIEWS, often).config).coding_loss == FINEST


@pytest.mark.parametrize("preset", OURS)
def test_less_is_pruned_of_levels_that_see_the_photos_seldom(preset: str) -> None:
    start = preset_of(preset).config
    usual, steps = joint(start).prune_share, start.train.steps + start.levels.steps
    seldom = resolve_settings(preset, round(4 * steps / PASSES))
    assert joint(seldom.config).prune_share == pytest.approx(usual * 0.25**PASS_EXPONENT, rel=0.01)
    assert joint(resolve_settings(preset, MANY_VIEWS).config).prune_share == usual


@pytest.mark.parametrize("preset", ["standard", "max"])
def test_few_views_of_few_points_have_to_grow(preset: str) -> None:
    usual = preset_of(preset).config.train
    found = [resolve_settings(preset, 10, points=count) for count in (0, 1_920, 2_400, 2_880)]
    trains = [recipe.config.train for recipe in found]
    assert {train.dropout for train in trains} == {0.3}
    until = usual.growth.until
    ends = [until, until, (until * 0.15) ** 0.5, 0.15]  # between both as the blend is, geometric
    assert [train.growth.until for train in trains] == pytest.approx(ends)
    assert found[2].source("train.growth.until").endswith("2,400 points")


@pytest.mark.parametrize("preset", OURS)
def test_of_few_points_heads_are_narrow_and_growth_is_finer_unless_asked_for(preset: str) -> None:
    usual = preset_of(preset).config
    points = (0, 1_344, 2_000, 2_600, MANY_POINTS, 80_000)
    found = [resolve_settings(preset, 60, points=count).config for count in points]
    assert [config.model.hidden for config in found] == [16, 16, 24, 32, 48, 48]
    cells = [config.train.growth.cell for config in found]
    finest = max(16, round(FINEST_CELL * usual.train.growth.cell))
    assert cells[:2] == [finest] * 2
    assert cells == sorted(cells) and cells[-2:] == [usual.train.growth.cell] * 2
    few = resolve_settings(preset, 60, points=1_344)
    assert few.source("model.hidden").endswith("1,344 points")
    names = {"model.hidden": 40, "train.growth.cell": 12}
    asked = resolve_settings(preset, 60, names, points=1_344)
    assert (asked.config.model.hidden, asked.config.train.growth.cell) == (40, 12)
    assert {asked.source(name) for name in names} == {"asked for"}
    assert resolve_settings("paper", 60, points=10).config.model.hidden == 32


def test_short_trainings_grow_faster_and_prune_more() -> None:
    usual = preset_of("standard").config.train.growth.threshold
    short = resolve_settings("standard", MANY_VIEWS, {"train.steps": round(0.6 * GROWING_STEPS)})
    assert short.config.train.growth.threshold == pytest.approx(0.6 * usual)
    assert joint(short.config).prune_share == pytest.approx(0.0036 / 0.6)
    shortest = resolve_settings("standard", MANY_VIEWS, {"train.steps": 3})
    assert shortest.config.train.growth.threshold == pytest.approx(SHORTEST * usual)
