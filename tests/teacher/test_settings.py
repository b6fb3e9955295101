"""Settings of a splat as the teacher: what follows from it, unless something else is asked for."""

from gsynopsis.config import Joint, Sequential
from gsynopsis.teacher.settings import teacher_recipe


def test_levels_of_renders_are_two_a_step_and_more_renders_take_more_steps() -> None:
    for views, steps in ((16, 1200), (112, 1200), (336, 3600), (2000, 6000)):
        levels = teacher_recipe(2_000_000, views, 0.01, {}).config.levels
        assert isinstance(levels, Joint)
        assert (levels.steps, levels.levels_per_step) == (steps, 2)
        assert levels.loss_weights == (1.2, 1.1, 1.5)


def test_sequential_levels_take_what_they_have_of_it() -> None:
    recipe = teacher_recipe(1000, 112, 0.01, {"levels.mode": "sequential"})
    levels = recipe.config.levels
    assert isinstance(levels, Sequential)
    assert (levels.steps, levels.keep) == (3000, (0.5, 0.4, 0.3))


def test_small_inputs_are_trained_longer_and_that_is_continuous() -> None:
    inputs = (1, 111_111, 250_000, 444_444, 999_999, 1_000_000, 12_000_000)
    configs = [teacher_recipe(splats, 112, 0.01, {}).config for splats in inputs]
    assert [config.levels.steps for config in configs] == [3600, 3600, 2400, 1800, 1200, 1200, 1200]
    assert [config.train.steps for config in configs] == [500, 500, 500, 375, 250, 250, 250]


def test_growth_ends_at_fewer_anchors_a_pixel_than_of_photos() -> None:
    config = teacher_recipe(1000, 112, 0.01, {}).config
    assert config.train.growth.until == 0.7
    assert 0 < config.train.growth.per_pixel < 1
    assert config.train.growth.max_anchors == 333
    assert config.levels.keep == (0.5, 0.4, 0.3)
    assert teacher_recipe(1_000_000, 112, 0.01, {}).config.levels.keep == (0.6, 0.5, 0.4)
    assert teacher_recipe(444_444, 112, 0.01, {}).config.levels.keep == (0.55, 0.45, 0.35)
    asked = {"train.growth.until": 0.0}
    assert teacher_recipe(1000, 112, 0.01, asked).config.train.growth.until == 0


def test_steps_of_levels_follow_those_that_are_asked_for() -> None:
    recipe = teacher_recipe(1_000_000, 112, 0.01, {"train.steps": 500})
    assert (recipe.config.train.steps, recipe.config.levels.steps) == (500, 2400)
    assert recipe.source("levels.steps") == "1,000,000 splats to copy, 112 renders"


def test_what_is_asked_for_wins() -> None:
    asked = {"levels.steps": 7, "train.steps": 3, "levels.levels_per_step": 2}
    recipe = teacher_recipe(1000, 112, 0.01, asked)
    levels = recipe.config.levels
    assert isinstance(levels, Joint)
    assert (levels.steps, recipe.config.train.steps, levels.levels_per_step) == (7, 3, 2)
