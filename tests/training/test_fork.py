"""A fork on held-back photos: which they are, that it repeats, and what it tells apart."""

from dataclasses import replace

import pytest

from gsynopsis.render.choose import make_renderer
from gsynopsis.training.context import TrainContext
from gsynopsis.training.fork import FEWEST_HELD, Fork, fork_exposure, held_back
from gsynopsis.training.observer import Silent
from tests.tiny import tiny_config, tiny_scene


def test_one_training_photo_in_ten_is_held_back_at_least_three_spread_over_all() -> None:
    scene = tiny_scene()
    for count, held in ((9, 3), (10, 3), (43, 4), (120, 12)):
        views = replace(scene, train=tuple(range(0, 2 * count, 2)), test=(1,))
        tried = held_back(views)
        assert tried is not None and len(tried.test) == held
        assert sorted({*tried.test, *tried.train}) == list(views.train)
        assert not set(tried.test) & set(tried.train) and 1 not in tried.test
        gaps = [b - a for a, b in zip(tried.test, tried.test[1:], strict=False)]
        assert max(gaps) - min(gaps) <= 2
    assert held_back(replace(scene, train=tuple(range(8)))) is None, "five would be left"


def test_gain_and_its_doubt_are_of_pairs() -> None:
    fork = Fork(off=(20.0, 30.0, 25.0), on=(20.5, 30.5, 25.5))
    assert fork.gain == pytest.approx(0.5) and fork.doubt == pytest.approx(0, abs=1e-9)
    mixed = Fork(off=(20.0, 20.0, 20.0), on=(23.0, 19.0, 19.0))
    assert mixed.gain == pytest.approx(1 / 3) and mixed.doubt > mixed.gain


def context(steps: int = 250, views: int = 12) -> TrainContext:
    config, scene = tiny_config(), tiny_scene(views=views)
    config = replace(config, train=replace(config.train, steps=steps))
    scene = replace(scene, train=scene.train[:views])
    return TrainContext(scene, config, make_renderer("cpu"))


def test_a_fork_repeats_and_leaves_scene_and_settings_alone() -> None:
    first = context()
    before = first.scene.train, first.config
    one, two = (fork_exposure(first, Silent()) for _ in range(2))
    assert one is not None and one == two
    assert len(one.on) == FEWEST_HELD
    assert (first.scene.train, first.config) == before


def test_too_few_steps_or_photos_are_not_tried() -> None:
    assert fork_exposure(context(steps=200), Silent()) is None
    assert fork_exposure(context(views=9), Silent()) is None


def test_a_fork_stops_when_it_is_told_to() -> None:
    asks = iter([False] * 10)
    with pytest.raises(KeyboardInterrupt):
        fork_exposure(context(), Silent(), lambda: next(asks, True))
