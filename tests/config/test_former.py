"""Records of version 0.1's settings are read; what has no counterpart is refused by name."""

import json
from typing import Any

import pytest

from gsynopsis.config import Joint, Sequential, config_from_json, resolve_settings
from gsynopsis.config.former import CONSTANTS, SPREAD
from gsynopsis.config.store import values_of
from gsynopsis.errors import SettingError
from gsynopsis.model import build
from gsynopsis.training import growth, ranking, state, unfold

FORMER: dict[str, Any] = json.loads(
    """{"preset": "fast", "scale": 4.0, "split": "every8",
 "model": {"feature": "synopsis", "fusion": "none", "slots": 16, "grids": 0, "table_log2": 15,
  "codebook": 0, "codebook_dim": 32, "residual": 12, "hidden": 48, "fuse_hidden": 64,
  "fuse_out": 32, "opacity_bias": 0.3, "opacity_spread": 4.0, "bounds": "contract", "voxel": 0.0,
  "init_factor": 40},
 "train": {"steps": 1500, "seed": 0, "batch": 1, "ssim_weight": 0.2, "volume_weight": 0.001,
  "opacity_weight": 0.01, "average": 0.15, "subpixels": 2, "checkpoint_seconds": 120.0,
  "rates": {"offset": [0.01, 0.002], "scale": [0.007, 0.0028], "logits": [0.01, 0.0001],
   "codebook": [0.0075, 0.00075], "residual": [0.015, 0.015], "free": [0.015, 0.015],
   "grid": [0.02, 0.006], "fuse": [0.005, 1e-05], "opacity": [0.002, 0.0004],
   "cov": [0.004, 0.0016], "color": [0.008, 0.0008], "gain": [0.005, 0.0005],
   "mask": [0.01, 0.01]},
  "growth": {"statistics_from": 0.016666666666666666, "adjust_from": 0.05, "until": 0.7,
   "every": 100, "threshold": 3.5e-05, "grow_visits": 0.1, "prune_visits": 0.4,
   "prune_opacity": 0.005, "levels": 3, "max_anchors": 1000000, "strict_scaffold": false}},
 "levels": {"mode": "joint", "keep": [0.7, 0.5, 0.4], "grid_drop": 2, "steps": 2500,
  "selection": "controller", "sparsity": [0.002, 0.004, 0.008], "group_weight": 3.0,
  "mask_threshold": 0.01, "ablation": "full", "resolution": "own", "gain": true,
  "joint_rates": 1.0, "spread": 0.125, "faint_share": 0.0036, "together": 3,
  "always_finest": true, "weights": [0.6, 0.8, 1.1], "networks": "common", "adapt": 0.0,
  "level_mib": [], "coding_loss": 0.1, "finish": 0}}"""
)
"""What version 0.1 recorded of fox at scale 4."""


def former(**changes: Any) -> str:
    values = json.loads(json.dumps(FORMER))
    for name, value in changes.items():
        inner = values
        *groups, last = name.split("__")
        for group in groups:
            inner = inner[group]
        inner[last] = value
    return json.dumps(values)


def test_a_former_record_is_what_the_same_preset_resolves_to_today() -> None:
    """But for the bound of growth by pixels, which that version did not have."""
    asked = {"scale": 4.0, "train.growth.per_pixel": 0.0}
    assert config_from_json(former()) == resolve_settings("fast", 43, asked).config


def test_few_views_of_then_are_read_as_they_were() -> None:
    config = config_from_json(former(levels__networks="own", model__slots=10))
    assert isinstance(config.levels, Joint)
    assert (config.levels.weights, config.model.slots) == ("separate", 10)


def test_a_former_sequential_record_keeps_its_own_settings() -> None:
    text = former(levels__mode="sequential", levels__gain=False, levels__always_finest=False)
    levels = config_from_json(text).levels
    assert levels == Sequential(steps=2500, group_weight=3.0)


def test_a_setting_that_its_version_did_not_have_was_at_its_default_of_then() -> None:
    values = json.loads(former())
    for name in ("weights", "together", "networks"):
        del values["levels"][name]
    levels = config_from_json(json.dumps(values)).levels
    assert isinstance(levels, Joint)
    assert (levels.loss_weights, levels.levels_per_step, levels.weights) == ((), 2, "separate")


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"levels__finish": 200}, "levels.finish"),
        ({"levels__gain": False}, "levels.gain"),
        ({"levels__spread": 0.0}, "levels.spread"),
        ({"levels__always_finest": False}, "levels.always_finest"),
        ({"model__codebook_dim": 16}, "model.codebook_dim"),
        ({"model__grids": 12, "levels__grid_drop": 1}, "levels.grid_drop"),
        ({"train__rates__offset": [0.02, 0.002]}, "train.rates"),
        ({"train__growth__strict_scaffold": True}, "train.growth.strict_scaffold"),
    ],
)
def test_what_is_a_constant_today_and_was_another_is_refused(
    changes: dict[str, Any], name: str
) -> None:
    with pytest.raises(SettingError, match=name.replace(".", r"\.")):
        config_from_json(former(**changes))


def test_a_joint_record_before_the_finest_level_was_in_every_step_is_refused() -> None:
    values = json.loads(former())
    del values["levels"]["always_finest"]
    with pytest.raises(SettingError, match=r"levels\.always_finest"):
        config_from_json(json.dumps(values))


def test_a_record_of_today_s_names_loses_what_is_a_constant_since() -> None:
    config = resolve_settings("fast").config
    values = values_of(config)
    values["levels"]["always_finest"] = True
    assert config_from_json(json.dumps(values)) == config
    values["levels"]["always_finest"] = False
    with pytest.raises(SettingError, match=r"levels\.always_finest"):
        config_from_json(json.dumps(values))


def test_time_between_checkpoints_was_a_setting_and_is_none_now() -> None:
    assert config_from_json(former(train__checkpoint_seconds=5.0)) == config_from_json(former())


@pytest.mark.parametrize("change", [{"model": 5}, {"levels": {}}, {"levels": {"mode": "x"}}])
def test_a_former_record_that_was_edited_is_refused_or_read(change: dict[str, Any]) -> None:
    text = json.dumps(json.loads(former()) | change)
    if change == {"levels": {}}:
        assert isinstance(config_from_json(text).levels, Sequential)
        return
    with pytest.raises(SettingError):
        config_from_json(text)


def test_constants_are_what_training_uses_today() -> None:
    """Settings stand below the rooms that use them, so the values stand twice."""
    today = {
        "model.codebook_dim": build.CODEBOOK_DIM,
        "model.fuse_hidden": build.FUSE_WIDTHS[0],
        "model.fuse_out": build.FUSE_WIDTHS[1],
        "train.ssim_weight": state.SSIM_WEIGHT,
        "train.volume_weight": state.VOLUME_WEIGHT,
        "train.growth.statistics_from": growth.STATISTICS_FROM,
        "train.growth.adjust_from": growth.ADJUST_FROM,
        "train.growth.prune_opacity": growth.PRUNE_OPACITY,
        "train.growth.levels": growth.LEVELS,
        "levels.mask_threshold": unfold.MASK_THRESHOLD,
    }
    assert {name: CONSTANTS[name] for name in today} == today
    assert ranking.COVERAGE == SPREAD
