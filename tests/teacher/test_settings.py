"""Settings of a splat as the teacher: what follows from it, unless something else is asked for."""

from gsynopsis.config import Joint, Sequential
from gsynopsis.teacher.settings import teacher_recipe


def test_levels_of_renders_are_two_a_step_however_many_there_are() -> None:
    for views in (16, 112, 400):
        levels = teacher_recipe(1000, views, 0.01, {}).config.levels
        assert isinstance(levels, Joint)
        assert (levels.steps, levels.levels_per_step) == (1200, 2)
        assert levels.loss_weights == (1.2, 1.1, 1.5)


def test_sequential_levels_take_what_they_have_of_it() -> None:
    recipe = teacher_recipe(1000, 112, 0.01, {"levels.mode": "sequential"})
    levels = recipe.config.levels
    assert isinstance(levels, Sequential)
    assert (levels.steps, levels.keep) == (1000, (0.6, 0.5, 0.4))
    assert recipe.config.train.growth.until == 0


def test_what_is_asked_for_wins() -> None:
    asked = {"levels.steps": 7, "train.steps": 3, "levels.levels_per_step": 2}
    recipe = teacher_recipe(1000, 112, 0.01, asked)
    levels = recipe.config.levels
    assert isinstance(levels, Joint)
    assert (levels.steps, recipe.config.train.steps, levels.levels_per_step) == (7, 3, 2)
