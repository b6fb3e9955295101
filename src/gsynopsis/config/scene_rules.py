"""Rules by which our presets follow the number of photos and of steps (ours).

Each rule is a continuous function of both, so that one photo more changes a little. Few photos are
soon overfit: from `MANY_VIEWS` down to `FEW_VIEWS` training views the settings move from the
preset's values to values with less growth (docs/methods.md §2.8).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gsynopsis.config.serialize import get
from gsynopsis.config.settings import Config, GrowthConfig, Joint, ModelConfig, total_steps

FEW_VIEWS, MANY_VIEWS = 15, 40
"""Training views of a scene at either end; between scenes of 15 and of 43."""
PASSES = 56
"""Times that training sees each photo, up to which `prune_share` grows."""
USUAL_STEPS = 4_000
"""Steps of preset `standard`, levels included."""
PASS_EXPONENT = 0.5
"""Exponent with which `prune_share` falls below `PASSES` epochs: less time to recover."""
FEW_PASSES, MANY_PASSES = 16, 56
"""Epochs of a training of the preset's length, from the values for few to the preset's."""
FEW_PASSES_LEVELS = 2.0
"""`levels_per_step` of few epochs: the finest level needs the time most."""
FEW_PASSES_WEIGHTS = (1.2, 1.1, 1.5)
"""`loss_weights` then: a coarse level is seen half as often."""
FEW_PASSES_STEPS = 1.28
"""Joint steps then, of those with three levels: they take about as long."""
FINE_PASSES = 100
"""Times that training sees each photo, from which on `coding_loss` falls."""
FINE_EXPONENT = 1.5
"""Exponent with which `coding_loss` falls beyond `FINE_PASSES` epochs."""
FINEST = 0.03
"""Least `coding_loss`, dB: less is not seen."""
GROWING_STEPS = 1_500
"""Steps of full training up to which the growth threshold rises: shorter ones grow faster."""
SHORTEST = 0.5
"""Least share of them that fewer steps count as: by a threshold near zero everything grows."""
FEW_INIT_SCALE = 2.0
"""`opacity_init_scale` of few views."""
FEW_DROPOUT = 0.3
"""`dropout` of few views."""
FEW_GROWTH = 0.15
"""Share of the full training's steps after which their growth ends, of three quarters of
`MANY_POINTS` or more; half of them have to grow."""
FEW_VIEW_START, FEW_VIEW_EXPONENT = 1.3, 3
"""Exponents of the blend from few-view values back to the preset's: it begins slowly, so that one
photo more than `FEW_VIEWS` changes a little, and is nearly over at twice as many."""
MANY_POINTS = 3_840
"""Sparse points of a scene from which on settings are the preset's."""
BY_POINTS = ("model.hidden", "train.growth.cell", "train.growth.until")
"""Settings that follow them."""
NARROWEST, MULTIPLE = 16, 8
"""Hidden units of the heads at least, and what their number is a multiple of (lanes of a CPU)."""
REDUCED_UNTIL = (0.3, 0.6)
"""`reduced_until` of large photos."""
FEW_PASSES_LONGER = 1.35
"""Steps of few epochs of large photos, of the preset's: small ones leave the time for them."""
SMALL_SIDE, LARGE_SIDE = 384, 512
"""Pixels across the photos, from none of it to all of it. Fox at 132 pixels lost 0.3 dB by it; and
where small photos end before growth does (the demo, 320 pixels), more is grown than they save."""
FINEST_CELL = 0.6
"""Least factor on the coarsest growth cell, so that it is never finer than Scaffold-GS's."""


@dataclass(frozen=True)
class Facts:
    """Facts of a training that the rules depend on.

    Attributes:
        views: Training photos.
        steps: Training steps of all phases.
        level_steps: Those of the levels.
        passes: Epochs of the whole training; fewer photos than `MANY_VIEWS` count as `MANY_VIEWS`.
        usual_passes: Of a training of `USUAL_STEPS`, where this one is shorter: a short training
            of few photos is not one of many.
        many: Weight of the many-view values: 0 up to `FEW_VIEWS` photos, 1 from `MANY_VIEWS` on.
        growth_ratio: Steps of full training divided by `GROWING_STEPS`, `SHORTEST` to 1.
        point_ratio: Sparse points divided by `MANY_POINTS`, 0 to 1.
        large: `many`, times 0 up to `SMALL_SIDE` pixels across and 1 from `LARGE_SIDE` on. Few
            photos overfit what small ones grow (brighton at its stored size).
    """

    views: int
    steps: int
    level_steps: int
    passes: float
    usual_passes: float
    many: float
    growth_ratio: float
    point_ratio: float
    large: float


def facts_of(config: Config, views: int, points: int = MANY_POINTS, side: float = 0) -> Facts:
    """The facts of a training on `views` photos, `side` pixels across, and `points` sparse points.

    `side` is the shorter one of the largest photo at the training resolution.
    """
    steps = total_steps(config)
    many = _share(views, FEW_VIEWS, MANY_VIEWS)
    passes = steps * config.train.batch / max(MANY_VIEWS, views)
    return Facts(
        views=views,
        steps=steps,
        level_steps=config.levels.steps,
        passes=passes,
        usual_passes=passes * max(1.0, USUAL_STEPS / steps),
        many=many,
        growth_ratio=min(1.0, max(SHORTEST, config.train.steps / GROWING_STEPS)),
        point_ratio=min(1.0, points / MANY_POINTS),
        large=many * _share(side, SMALL_SIDE, LARGE_SIDE),
    )


def step_factor(config: Config, views: int, side: float) -> float:
    """Factor on the preset's steps, so that many large photos are seen more often.

    Args:
        config: Settings of the training, with the preset's steps.
        views: Training photos.
        side: Pixels across the largest, see `facts_of`.
    """
    if not isinstance(config.levels, Joint):
        return 1.0
    facts = facts_of(config, views, side=side)
    return 1 + (FEW_PASSES_LONGER - 1) * facts.large * (1 - _much(facts.usual_passes))


def adapt(usual: Config, facts: Facts) -> Mapping[str, Any]:
    """Values of all settings that follow the facts, by dotted name.

    Args:
        usual: Settings of the preset, for many photos and enough steps.
        facts: Of the training.
    """
    model, growth, many = usual.model, usual.train.growth, facts.many
    growth_ratio = facts.growth_ratio**many
    scarce = (1 - many**FEW_VIEW_START) ** FEW_VIEW_EXPONENT
    grown = scarce * min(1.0, max(0.0, 4 * facts.point_ratio - 2))
    cell = max(GrowthConfig.cell, growth.cell * max(FINEST_CELL, facts.point_ratio))
    found: dict[str, Any] = {
        "model.slots": round(ModelConfig.slots + many * (model.slots - ModelConfig.slots)),
        "model.opacity_init_scale": FEW_INIT_SCALE
        + many * (model.opacity_init_scale - FEW_INIT_SCALE),
        "model.hidden": _head_width(model.hidden, facts.point_ratio),
        "train.dropout": usual.train.dropout + scarce * (FEW_DROPOUT - usual.train.dropout),
        "train.growth.cell": round(_between(GrowthConfig.cell, cell, many)),
        "train.growth.until": _between(FEW_GROWTH, growth.until, 1 - grown),
        "train.growth.threshold": _between(
            GrowthConfig.threshold, growth.threshold * facts.growth_ratio, many
        ),
    }
    levels = usual.levels
    if isinstance(levels, Joint):
        if facts.large:
            found["train.reduced_until"] = tuple(facts.large * share for share in REDUCED_UNTIL)
        share = levels.prune_share * min(1.0, facts.passes / PASSES) ** PASS_EXPONENT / growth_ratio
        loss = levels.coding_loss * min(1.0, FINE_PASSES / facts.passes) ** FINE_EXPONENT
        found |= {"levels.prune_share": share, "levels.coding_loss": max(FINEST, loss)}
        much = _much(facts.usual_passes)
        if levels.levels_per_step > FEW_PASSES_LEVELS and much < 1:
            more = levels.levels_per_step - FEW_PASSES_LEVELS
            pairs = zip(FEW_PASSES_WEIGHTS, levels.loss_weights, strict=False)
            found["levels.levels_per_step"] = FEW_PASSES_LEVELS + much * more
            found["levels.loss_weights"] = tuple(_between(few, w, much) for few, w in pairs)
            longer = much + (1 - much) * FEW_PASSES_STEPS
            found["levels.steps"] = round(longer * facts.level_steps)
    return {name: value for name, value in found.items() if get(usual, name) != value}


def _share(value: float, none: float, whole: float) -> float:
    """Weight of a value by its logarithm: 0 up to `none`, 1 from `whole` on."""
    return min(1.0, max(0.0, math.log(max(value, 1) / none) / math.log(whole / none)))


def _much(passes: float) -> float:
    """Weight of the values for many passes: 0 up to `FEW_PASSES`, 1 from `MANY_PASSES` on."""
    return min(1.0, max(0.0, (passes - FEW_PASSES) / (MANY_PASSES - FEW_PASSES)))


def _between(few: float, many: float, weight: float) -> float:
    """Geometric mean of both, exactly the one or the other at the ends."""
    return few ** (1 - weight) * many**weight


def _head_width(widest: int, point_ratio: float) -> int:
    """Hidden units of the heads: all levels share them, and they come with the first."""
    fitting = MULTIPLE * round(widest * point_ratio / MULTIPLE)
    return min(widest, max(NARROWEST, fitting))
