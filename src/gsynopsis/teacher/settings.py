"""Settings of a training whose teacher is a finished splat: they follow what there is to copy."""

from collections.abc import Mapping
from typing import Any

from gsynopsis.config import Recipe, replaced, resolve_settings
from gsynopsis.config.scene_rules import FEW_PASSES_LEVELS, FEW_PASSES_WEIGHTS
from gsynopsis.config.serialize import get, names_of

PER_ANCHOR = 16
"""Splats of a cluster, and slots of an anchor: the first picture of biker's is as good as with half
as many of each, in half of the anchors."""
FULL_STEPS, JOINT_STEPS, SEQUENTIAL_STEPS = 250, 1200, 1000
"""Steps of the finest level alone, and of the levels in either way, of `LARGE` splats and `VIEWS`
renders."""
LARGE, VIEWS = 1_000_000, 112
FULL_MOST, SMALLER_MOST, MOST = 2.0, 3.0, 5.0
"""Factors at most on the steps of the finest level, on those of levels for fewer splats, and on
those in all. A step of few takes little time; more renders need as many passes."""
PER_PIXEL = 0.4
"""Anchors per pixel of a render that there may be by growth. Few splats an anchor are few anchors
in all, which training on renders outgrows; those of a million are as many as renders can tell."""
FEWEST_SPLATS = 3
"""Splats for each anchor that there may be by growth: with more anchors a file is hardly smaller
than that of its input."""
KEEP, KEEP_MORE = (0.5, 0.4, 0.3), 0.1
"""Shares of the anchors that a coarser level keeps where they grow most, and what is added to each
where none grow, so that level 0 has about as many."""
GROWING = 1.75e-5
"""Growth threshold: half of the preset's, as so few steps have half of its rounds."""


def teacher_recipe(splats: int, views: int, voxel: float, asked: Mapping[str, Any]) -> Recipe:
    """The settings for an input; those that do not follow from it are of the preset `standard`.

    Args:
        splats: Splats that anchors begin as.
        views: Renders to train on.
        voxel: Lattice cell, world units.
        asked: Settings by dotted name; they always win.

    Raises:
        SettingError: there is no such preset or setting, or a value cannot be.
    """
    base = resolve_settings("standard", views, asked)
    smaller = max(1.0, (LARGE / max(splats, 1)) ** 0.5)
    for_full = min(FULL_MOST, smaller)
    full = round(FULL_STEPS * for_full)
    for_levels = min(MOST, min(SMALLER_MOST, smaller) * max(1.0, views / VIEWS))
    if "train.steps" in asked:
        for_levels *= base.config.train.steps / full
    of_levels = JOINT_STEPS if base.config.levels.mode == "joint" else SEQUENTIAL_STEPS
    not_growing = 1 - (for_full - 1) / (FULL_MOST - 1)
    bound = base.config.train.growth.max_anchors
    own: dict[str, Any] = {
        "model.slots": PER_ANCHOR,
        "model.voxel": voxel,
        "model.bounds": "aabb",  # an input has its own backdrop
        "train.growth.per_pixel": PER_PIXEL,
        "train.growth.max_anchors": min(bound, max(1, splats // FEWEST_SPLATS)),
        "train.growth.threshold": GROWING,
        "train.exposure": "off",
        "train.steps": full,
        "levels.steps": max(1, round(for_levels * of_levels)),
        "levels.prune_share": 1.5e-4,
        "levels.coding_loss": 0.03,
        "levels.keep": tuple(round(share + KEEP_MORE * not_growing, 3) for share in KEEP),
        # Renders are seen a dozen times: the finest level needs the time most.
        "levels.levels_per_step": FEW_PASSES_LEVELS,
        "levels.loss_weights": FEW_PASSES_WEIGHTS,
    }
    reason = f"{splats:,} splats to copy, {views} renders"
    there = names_of(base.config.levels.mode)
    own = {name: own[name] for name in own if name not in asked and name in there}
    config = replaced(base.config, own)
    followed = {n: w for n, w in base.followed.items() if n not in own}
    followed |= {n: reason for n, v in own.items() if v != get(base.config, n)}
    return Recipe(base.preset, config, base.asked, followed)
