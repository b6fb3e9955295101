"""How presets suit themselves to the number of photos and of training steps (ours)."""

from dataclasses import replace
from typing import Any, TypeVar

from gsynopsis.config import (
    PRESETS,
    Config,
    GrowthConfig,
    LevelsConfig,
    ModelConfig,
    total_steps,
)

FEW_VIEWS = 40
"""Training views below which a scene is one of few views (between scenes of 15 and of 43; ours)."""
PASSES = 56
"""Times that training sees each photo, from which on `faint_share` is as the presets say (ours)."""
PASS_POWER = 0.5
"""Of fewer passes, that `faint_share` follows (ours: methods.md §2.8.1)."""
FINE_PASSES = 100
"""Times that training sees each photo, up to which `coding_loss` is as the presets say (ours)."""
FINE_POWER = 1.5
"""Of more passes, that `coding_loss` falls with (ours: methods.md §2.8.2)."""
FINEST = 0.03
"""Least `coding_loss` of the presets by that: less is not seen (ours)."""
GROWING_STEPS = 1_500
"""Steps of full training, from which on growth and its price are as the presets say (ours)."""
SHORTEST = 0.5
"""Least share of them that fewer steps count as: by a threshold near zero everything grows."""
SUITED = ("ours", "fast")
"""Presets that suit themselves to the number of training views and of steps."""
Part = TypeVar("Part", ModelConfig, GrowthConfig, LevelsConfig)


def for_views(config: Config, views: int) -> Config:
    """The same settings for so many training views; see `for_few_views`, `for_short_growth`.

    In the presets `ours` and `fast`, less may go of the levels where training sees each photo less
    than `PASSES` times, for what is left has less time to fill in; and values are rounded less
    where it sees them more than `FINE_PASSES` times, for then more slots would show little more.
    Few photos count as `FEW_VIEWS` (ours: methods.md §2.8). Values that are not the preset's stay.
    """
    if config.preset not in SUITED:
        return config
    usual, few = PRESETS[config.preset]().levels, views < FEW_VIEWS
    passes = total_steps(config) * config.train.batch / max(FEW_VIEWS, views)
    growth = 1.0 if few else _growth_share(config)
    share = usual.faint_share * min(1.0, passes / PASSES) ** PASS_POWER / growth
    loss = max(FINEST, usual.coding_loss * min(1.0, FINE_PASSES / passes) ** FINE_POWER)
    levels = _instead(config.levels, usual, faint_share=share, coding_loss=loss)
    suited = replace(config, levels=levels)
    return for_few_views(suited, views) if few else for_short_growth(suited)


def for_short_growth(config: Config) -> Config:
    """The same settings if growth has `GROWING_STEPS`, else such as grow faster.

    With fewer, the growth threshold of the presets `ours` and `fast` falls in proportion; and as
    there is more to choose from, `for_views` lets as much more go of the levels (ours:
    methods.md §2.8.3). A value that is not the preset's stays.
    """
    if config.preset not in SUITED:
        return config
    usual = PRESETS[config.preset]().train.growth
    threshold = usual.threshold * _growth_share(config)
    growth = _instead(config.train.growth, usual, threshold=threshold)
    return replace(config, train=replace(config.train, growth=growth))


def _growth_share(config: Config) -> float:
    """Steps that growth has, to those that it should have; at least `SHORTEST`, at most 1."""
    return min(1.0, max(SHORTEST, config.train.steps / GROWING_STEPS))


def for_few_views(config: Config, views: int) -> Config:
    """The same settings if views are many, else such as learn less by heart.

    What few photos show is soon learnt by heart. So with fewer than `FEW_VIEWS` the presets `ours`
    and `fast` grow as Scaffold-GS, with its number of slots, which start less apart, the finest
    level learns no more often than others, and each level has networks of its own (ours:
    methods.md §2.8.4). A value that is not the preset's stays.
    """
    if views >= FEW_VIEWS or config.preset not in SUITED:
        return config
    usual, slots, cell = PRESETS[config.preset](), ModelConfig.slots, ModelConfig.init_factor
    model = _instead(config.model, usual.model, opacity_spread=2.0, slots=slots, init_factor=cell)
    levels = _instead(config.levels, usual.levels, always_finest=False, networks="own")
    threshold = GrowthConfig.threshold
    growth = _instead(config.train.growth, usual.train.growth, threshold=threshold)
    return replace(config, model=model, levels=levels, train=replace(config.train, growth=growth))


def _instead(settings: Part, usual: Part, **values: Any) -> Part:
    """Settings with these values in place of those that still are the preset's."""
    changed = {n: v for n, v in values.items() if getattr(settings, n) == getattr(usual, n)}
    return replace(settings, **changed)
