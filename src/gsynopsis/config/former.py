"""Settings as versions up to 0.1 called and arranged them: `run.json`, checkpoints, `--set`.

Names moved; what was no longer of use has become a constant. A value of such a setting that is not
the constant has no counterpart, and the run that had it cannot go on.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from gsynopsis.config.rates import PAPER, RATES
from gsynopsis.errors import SettingError

RENAMED = {
    "model.init_factor": "train.growth.cell",
    "model.opacity_spread": "model.opacity_init_scale",
    "train.average": "train.weight_average",
    "train.subpixels": "train.subpixel_jitter",
    "levels.faint_share": "levels.prune_share",
    "levels.together": "levels.levels_per_step",
    "levels.weights": "levels.loss_weights",
    "levels.networks": "levels.weights",
}
"""New names by old ones; `levels.weights` was another setting then."""
WORDS = {"levels.networks": {"common": "tied", "own": "separate"}}
"""New values by old ones."""
ALWAYS_FINEST = "levels.always_finest"
"""Joint levels that render the finest in every step."""
CONSTANTS: dict[str, Any] = {
    "model.codebook_dim": 32,
    "model.fuse_hidden": 64,
    "model.fuse_out": 32,
    "train.ssim_weight": 0.2,
    "train.volume_weight": 0.001,
    "train.growth.statistics_from": 1 / 60,
    "train.growth.adjust_from": 1 / 20,
    "train.growth.prune_opacity": 0.005,
    "train.growth.levels": 3,
    "train.growth.strict_scaffold": False,
    "levels.mask_threshold": 0.01,
    "levels.joint_rates": 1.0,
    "levels.adapt": 0.0,
    ALWAYS_FINEST: True,
    "levels.finish": 0,
}
"""Settings that are gone, and the value they have now."""
LEVELS = {
    "joint": {
        "prune_share": 0.0,
        "levels_per_step": 2,
        "loss_weights": [],
        "weights": "separate",
        "coding_loss": 0.0,
    },
    "sequential": {},
}
"""Defaults that were others."""
ONLY = {
    "joint": ("selection", "sparsity", "group_weight", "ablation", "resolution"),
    "sequential": (
        "spread",
        "prune_share",
        "levels_per_step",
        "loss_weights",
        "weights",
        "coding_loss",
        "level_mib",
    ),
}
"""Settings that every record held, and that meant nothing in this mode."""
SPREAD = 0.125
"""`levels.spread` of joint levels: a constant of `training.ranking` now."""


def is_former(values: Mapping[str, Any]) -> bool:
    """Whether a record of settings is of a version up to 0.1."""
    return "preset" in values


def upgraded(values: Mapping[str, Any]) -> dict[str, Any]:
    """A record of settings under today's names; one of today loses what is a constant since.

    Raises:
        SettingError: a value has no counterpart any more.
    """
    if not is_former(values):
        return _without_constants(values)
    flat = {name: value for name, value in _flat(values, "") if name != "preset"}
    rates = {k.rpartition(".")[2]: v for k, v in flat.items() if k.startswith("train.rates.")}
    flat = {k: v for k, v in flat.items() if not k.startswith("train.rates.")}
    flat.pop("train.checkpoint_seconds", None)
    mode = str(flat.get("levels.mode", "sequential"))
    finest = flat.pop(ALWAYS_FINEST, False)
    _need(ALWAYS_FINEST, finest or mode == "sequential", _same(True), True)
    _drop_constants(flat)
    grids = flat.get("model.grids", 12) if flat.get("model.feature") != "free" else 0
    drop, gain = flat.pop("levels.grid_drop", 2), flat.pop("levels.gain", False)
    tied = mode == "joint" and flat.get("levels.networks") == "common"
    wanted = 0 if tied else max(1, grids // 6)
    _need("levels.grid_drop", drop, lambda d: not grids or d == wanted, wanted)
    _need("levels.gain", gain, _same(mode == "joint"), mode == "joint")
    if mode == "joint":
        spread = flat.pop("levels.spread", 0.0)
        _need("levels.spread", spread, _same(SPREAD), SPREAD)
    moved = {
        RENAMED.get(n, n): WORDS.get(n, {}).get(v, v) if n in WORDS else v for n, v in flat.items()
    }
    moved = {f"levels.{n}": v for n, v in LEVELS.get(mode, {}).items()} | moved
    moved = {n: v for n, v in moved.items() if n.removeprefix("levels.") not in ONLY.get(mode, ())}
    moved["train.rates"] = _table({name: tuple(pair) for name, pair in rates.items()})
    return _nested(moved)


def _without_constants(values: Mapping[str, Any]) -> dict[str, Any]:
    flat = dict(_flat(values, ""))
    if CONSTANTS.keys().isdisjoint(flat):
        return dict(values)
    _drop_constants(flat)
    return _nested(flat)


def _drop_constants(flat: dict[str, Any]) -> None:
    for name, constant in CONSTANTS.items():
        _need(name, flat.pop(name, constant), _same(constant), constant)


def new_name(name: str, value: Any) -> tuple[str, Any]:
    """Today's name and value of a setting that is given by an old name; else as they are.

    Raises:
        SettingError: the setting is a constant now, and another one.
    """
    if name in CONSTANTS:
        _need(name, value, _same(CONSTANTS[name]), CONSTANTS[name])
    if name in WORDS:
        return RENAMED[name], WORDS[name].get(value, value)
    if name == "levels.weights" and not isinstance(value, str):
        return RENAMED[name], value
    return (RENAMED[name], value) if name in RENAMED and name != "levels.weights" else (name, value)


def _table(rates: Mapping[str, Any]) -> str:
    """Name of the table of these rates; in which unit they are meant was not recorded then."""
    for name, table in RATES.items():
        if replace(PAPER, unit_extent=table.unit_extent, **rates) == table:
            return name
    raise SettingError("train.rates", found="other rates", expected="those of paper or ours")


def _same(constant: Any) -> Callable[[Any], bool]:
    if isinstance(constant, float):
        return lambda value: math.isclose(value, constant)
    return lambda value: value == constant


def _need(name: str, value: Any, holds: Callable[[Any], bool], expected: Any) -> None:
    if not holds(value):
        advice = "it is a constant of this version; use the version that wrote the run"
        raise SettingError(name, found=value, expected=expected, advice=advice)


def _flat(values: Mapping[str, Any], above: str) -> list[tuple[str, Any]]:
    found: list[tuple[str, Any]] = []
    for key, value in values.items():
        name = f"{above}{key}"
        inner = isinstance(value, Mapping)
        found += _flat(value, f"{name}.") if inner else [(name, value)]
    return found


def _nested(flat: Mapping[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in flat.items():
        *groups, last = name.split(".")
        inner = found
        for group in groups:
            inner = inner.setdefault(group, {})
        inner[last] = value
    return found
