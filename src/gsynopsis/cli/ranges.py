"""Whether a `Config` can be used: the one place that asks, for every command, before any training.

Ranges stand beside the fields in `config.py`; what several fields must be together stands here.
"""

import math
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from itertools import pairwise
from typing import Any, Literal, cast, get_args, get_origin, get_type_hints

from gsynopsis.config import Config, LevelsConfig, ModelConfig, Range
from gsynopsis.errors import SettingError

OPTIONS = {
    "preset": "--preset",
    "scale": "--scale",
    "split": "--split",
    "train.steps": "--steps",
    "train.seed": "--seed",
    "train.batch": "--batch",
    "train.growth.max_anchors": "--max-anchors",
    "levels.keep": "--keep",
    "levels.level_mib": "--level-mib",
}
"""Settings that have an option of their own; the others are called by their place in `Config`."""


def check_config(config: Config) -> None:
    """Refuse settings that no run can use.

    Raises:
        SettingError: naming the option, what was found and what is expected.
    """
    for path, value, hint in _settings(config, ""):
        name = OPTIONS.get(path, path)
        kinds = get_args(hint)
        if get_origin(hint) is Literal:
            _expect(name, value, value in kinds, " or ".join(map(str, kinds)))
        elif len(kinds) > 1 and isinstance(kinds[1], Range):
            _expect(name, value, _within(value, kinds[1]), _text(value, kinds[1]))
    _check_levels(config.levels)
    _check_networks(config.model, config.levels)


def _settings(part: object, above: str) -> Iterator[tuple[str, Any, Any]]:
    """Dotted name, value and annotation of every setting."""
    hints = get_type_hints(type(part), include_extras=True)
    for field in fields(cast("Any", part)):
        value, path = getattr(part, field.name), f"{above}{field.name}"
        if is_dataclass(value):
            yield from _settings(value, f"{path}.")
        else:
            yield path, value, hints[field.name]


def _within(value: Any, limits: Range) -> bool:
    if isinstance(value, tuple):
        numbers = cast("tuple[float, ...]", value)
        least, most = limits.counts
        return least <= len(numbers) <= most and all(_within(v, limits) for v in numbers)
    low = limits.low < value if limits.open == "low" else limits.low <= value
    high = value < limits.high if limits.open == "high" else value <= limits.high
    # A whole number may be too long for a float, but then it is out of every range.
    return low and high and math.isfinite(value)


def _text(value: object, limits: Range) -> str:
    """What a range expects, for people."""
    if limits.open == "low":
        text = f"above {limits.low:,}"
        text += f", at most {limits.high:,}" if math.isfinite(limits.high) else ""
    elif limits.open == "high":
        text = f"{limits.low:,} to below {limits.high:,}"
    elif math.isfinite(limits.high):
        text = f"{limits.low:,} to {limits.high:,}"
    else:
        text = f"at least {limits.low:,}, finite"
    if not isinstance(value, tuple):
        return text
    least, most = limits.counts
    count = f"{least}" if least == most else f"{least} to {most}"
    return f"{count} numbers, each {text}"


def _check_levels(levels: LevelsConfig) -> None:
    ordered = levels.level_mib
    rising = all(a < b for a, b in pairwise(ordered))
    fits = rising and len(ordered) == levels.count and levels.mode == "joint"
    expected = f"{levels.count} rising sizes above 0, with levels joint"
    _expect("--level-mib", ordered, not ordered or fits, expected)


def _check_networks(model: ModelConfig, levels: LevelsConfig) -> None:
    alike = model.feature == "free" or not (model.grids and levels.grid_drop)
    expected = "own, or levels.grid_drop 0, as levels read fewer grids the coarser they are"
    _expect("levels.networks", levels.networks, alike or not levels.common_networks, expected)
    reads = model.feature == "free" or model.grids + model.codebook + model.residual > 0
    _expect("model.grids, codebook, residual", "all 0", reads, "some feature")


def _expect(name: str, found: object, holds: bool, expected: str) -> None:
    if not holds:
        raise SettingError(name, found=found, expected=expected)
