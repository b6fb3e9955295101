"""Settings, presets, and their JSON."""

from gsynopsis.config.presets import PRESETS, Preset, PresetName, preset_of
from gsynopsis.config.rates import RATES, RateConfig, RateTable
from gsynopsis.config.recipe import Recipe, preset_value, resolve_settings
from gsynopsis.config.serialize import (
    config_from_json,
    config_from_values,
    config_to_json,
    replaced,
    values_of,
)
from gsynopsis.config.settings import (
    GRID_RESOLUTIONS,
    LEVELS,
    Config,
    GrowthConfig,
    Joint,
    Levels,
    ModelConfig,
    Sequential,
    Split,
    TrainConfig,
    level_scale,
    total_steps,
)

__all__ = [
    "GRID_RESOLUTIONS",
    "LEVELS",
    "PRESETS",
    "RATES",
    "Config",
    "GrowthConfig",
    "Joint",
    "Levels",
    "ModelConfig",
    "Preset",
    "PresetName",
    "RateConfig",
    "RateTable",
    "Recipe",
    "Sequential",
    "Split",
    "TrainConfig",
    "config_from_json",
    "config_from_values",
    "config_to_json",
    "level_scale",
    "preset_of",
    "preset_value",
    "replaced",
    "resolve_settings",
    "total_steps",
    "values_of",
]
