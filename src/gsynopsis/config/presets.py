"""The presets: `paper` as the paper has it, the others our own anchor model, trained ever longer.

A preset is a short difference from the defaults, for either way of making levels.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal, NamedTuple, TypeAlias

from gsynopsis.config.settings import (
    Config,
    GrowthConfig,
    Joint,
    ModelConfig,
    Sequential,
    TrainConfig,
)
from gsynopsis.errors import SettingError

PresetName: TypeAlias = Literal["draft", "standard", "high", "max", "paper"]


class Preset(NamedTuple):
    """Settings of a preset.

    Attributes:
        name: Of the preset.
        config: With its own way of making levels.
        joint: Its joint levels.
        sequential: Its sequential levels.
        by_scene: Settings follow the number of photos and steps, see `scene_rules.py`.
    """

    name: PresetName
    config: Config
    joint: Joint
    sequential: Sequential
    by_scene: bool


OUR_MODEL = ModelConfig(
    fusion="none",
    slots=16,
    grids=0,
    codebook=0,
    residual=12,
    hidden=48,
    opacity_init_scale=4.0,
)
"""Sixteen slots and twelve values per anchor; with rates that let values learn, neither grids nor a
codebook are worth their bytes (methods.md §1.15)."""
PER_PIXEL = 1.3
"""Twelve values and sixteen slots an anchor: more anchors than pixels of a photo are overfit, and
cost more bytes than they are worth (methods.md §1.9)."""
OUR_TRAIN = TrainConfig(
    rates="ours",
    opacity_weight=0.01,
    weight_average=0.15,
    subpixel_jitter=2,
)
OUR_GROUP_WEIGHT = 3.0
"""λ_group of the paper's 0.01 moves nothing (§1.11.5)."""


def _paper() -> Preset:
    train = TrainConfig(exposure="off")
    config = Config(model=ModelConfig(table_log2=13, bounds="aabb"), train=train)
    joint = Joint(
        steps=10_000,
        prune_share=0,
        levels_per_step=2,
        loss_weights=(),
        weights="separate",
        coding_loss=0,
    )
    sequential = Sequential(selection="lambda")
    return Preset("paper", replace(config, levels=sequential), joint, sequential, by_scene=False)


def _ours(name: PresetName, longer: float) -> Preset:
    """Our own anchor model.

    Args:
        name: Of the preset.
        longer: Its steps, of those of `standard`.
    """
    growth = GrowthConfig(
        cell=40,
        until=0.7,
        threshold=3.5e-5,
        grow_visits=0.1,
        prune_visits=0.4,
        per_pixel=PER_PIXEL,
    )
    steps = round(2_500 * longer)
    joint = Joint(steps=steps)
    sequential = Sequential(steps=steps, group_weight=OUR_GROUP_WEIGHT)
    train = replace(OUR_TRAIN, steps=round(1_500 * longer), growth=growth)
    config = Config(model=OUR_MODEL, train=train, levels=joint)
    return Preset(name, config, joint, sequential, by_scene=True)


PRESETS: dict[PresetName, Preset] = {
    "draft": _ours("draft", 0.25),
    "standard": _ours("standard", 1),
    "high": _ours("high", 2),
    "max": _ours("max", 5),
    "paper": _paper(),
}
RecordedName: TypeAlias = PresetName | Literal["fast", "ours"]
RECORDED: Mapping[str, PresetName] = {
    **{name: name for name in PRESETS},
    "fast": "standard",
    "ours": "max",
}
"""Presets by the names that stand in records of runs, those of earlier versions too."""


def preset_of(name: str) -> Preset:
    """A preset by name.

    Raises:
        SettingError: there is no such preset.
    """
    for preset in PRESETS.values():
        if preset.name == name:
            return preset
    advice = f"it is {RECORDED[name]} now" if name in RECORDED else ""
    raise SettingError("--preset", found=name, expected=" or ".join(PRESETS), advice=advice)
