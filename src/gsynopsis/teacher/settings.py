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
SMALLER_MOST, MOST = 3.0, 8.0
"""Factors at most on the steps of levels, for fewer splats and in all. A step of few takes little
time; what is trained on more renders needs as many passes."""


def teacher_recipe(splats: int, views: int, voxel: float, asked: Mapping[str, Any]) -> Recipe:
    """The settings for an input; those that do not follow from it are of the preset `fast`.

    Args:
        splats: Splats that anchors begin as.
        views: Renders to train on.
        voxel: Lattice cell, world units.
        asked: Settings by dotted name; they always win.

    Raises:
        SettingError: there is no such preset or setting, or a value cannot be.
    """
    base = resolve_settings("fast", views, asked)
    joint = base.config.levels.mode == "joint"
    full = base.config.train.steps if "train.steps" in asked else FULL_STEPS
    longer = step_factor(splats, views) * full / FULL_STEPS
    own: dict[str, Any] = {
        "model.slots": PER_ANCHOR,
        "model.voxel": voxel,
        "model.bounds": "aabb",  # an input has its own backdrop
        "train.growth.until": 0.0,
        "train.exposure": "off",
        "train.steps": full,
        "levels.steps": max(1, round(longer * (JOINT_STEPS if joint else SEQUENTIAL_STEPS))),
        "levels.prune_share": 1.5e-4,
        "levels.coding_loss": 0.03,
        "levels.keep": (0.6, 0.5, 0.4),
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


def step_factor(splats: int, views: int) -> float:
    """Factor on the steps of levels for so many splats and renders, 1 to `MOST`."""
    smaller = min(SMALLER_MOST, max(1.0, (LARGE / max(splats, 1)) ** 0.5))
    return min(MOST, smaller * max(1.0, views / VIEWS))
