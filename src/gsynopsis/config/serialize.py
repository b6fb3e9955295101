"""Settings as nested plain values and as JSON, by msgspec; types and ranges are checked there.

What several settings must be together is checked here, see `_check_together`.
"""

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from functools import reduce
from itertools import pairwise
from typing import Any, cast, get_args, get_type_hints

import msgspec

from gsynopsis.config.settings import LEVELS, Config, Joint, Sequential
from gsynopsis.errors import SettingError

Values = dict[str, Any]
"""Settings as nested plain values, as in JSON."""
OPTIONS = {
    "preset": "--preset",
    "scale": "--scale",
    "split": "--split",
    "train.steps": "--steps",
    "train.seed": "--seed",
    "train.batch": "--batch",
    "train.growth.max_anchors": "--max-anchors",
    "model.feature": "--feature",
    "model.fusion": "--fusion",
    "levels.mode": "--levels",
    "levels.keep": "--keep",
    "levels.level_mib": "--level-mib",
    "levels.ablation": "--ablation",
}
"""Settings whose option is shorter than their name."""


NOT_SETTINGS = (
    *(ArithmeticError, AttributeError, LookupError),
    *(RecursionError, TypeError, ValueError),
)
"""Raised on the way through values that are of no form which any version wrote."""


@dataclass(frozen=True)
class _JointConfig(Config):
    levels: Joint = field(default_factory=Joint)  # pyright: ignore[reportIncompatibleVariableOverride]


@dataclass(frozen=True)
class _SequentialConfig(Config):
    levels: Sequential = field(default_factory=Sequential)  # pyright: ignore[reportIncompatibleVariableOverride]


_TYPED = {"joint": _JointConfig, "sequential": _SequentialConfig}
"""msgspec tells no two dataclasses apart, so the mode chooses first."""


def option_of(name: str) -> str:
    """The option of a setting on the command line: `--steps`, `--model.slots`."""
    return OPTIONS.get(name, f"--{name}")


def values_of(config: Config) -> Values:
    """Settings as nested plain values; tuples are lists."""
    return json.loads(config_to_json(config))


def config_to_json(config: Config) -> str:
    """Canonical JSON of all settings; equal text means equal settings."""
    # `asdict`, as msgspec would leave out what an instance has from its class.
    return json.dumps(asdict(config), sort_keys=True)


def config_from_json(text: str) -> Config:
    """Settings from JSON; what is missing is at its default.

    Raises:
        SettingError: a name, type or value cannot be.
    """
    try:
        values = json.loads(text)
        if not isinstance(values, dict):
            raise TypeError(f"{type(values).__name__}")
        return config_from_values(values)
    except NOT_SETTINGS as error:
        raise SettingError("settings", found=error, expected="those of a training") from error


def config_from_values(values: Mapping[str, Any]) -> Config:
    """Settings from nested plain values, checked; missing ones are at their defaults.

    Raises:
        SettingError: a name, type or value cannot be.
    """
    levels = values.get("levels", {})
    mode = levels.get("mode", "sequential") if isinstance(levels, Mapping) else "sequential"
    if not isinstance(mode, str) or mode not in LEVELS:
        raise SettingError(option_of("levels.mode"), found=mode, expected=" or ".join(LEVELS))
    _check_names(values, mode)
    try:
        typed = msgspec.convert(values, _TYPED[mode])
    except msgspec.ValidationError as error:
        raise _explained(error, values) from error
    config = Config(typed.scale, typed.split, typed.model, typed.train, typed.levels)
    _check_together(config)
    return config


def replaced(config: Config, changes: Mapping[str, Any]) -> Config:
    """The settings with some changed, checked; names are dotted, as `train.growth.threshold`.

    Raises:
        SettingError: a name, type or value cannot be.
    """
    values: Values = asdict(config)
    for name, value in changes.items():
        put(values, name, value)
    return config_from_values(values)


def put(values: Values, name: str, value: object) -> None:
    """Set a dotted name in nested values.

    Raises:
        SettingError: a part of the name is not a group of settings.
    """
    *groups, last = name.split(".")
    inner: Any = values
    for group in groups:
        inner = inner.get(group) if isinstance(inner, dict) else None
    if not isinstance(inner, dict):
        raise SettingError(option_of(name), found="no such setting")
    inner[last] = value


def get(config: Config, name: str) -> Any:
    """The value of a setting by its dotted name."""
    return reduce(getattr, name.split("."), cast("Any", config))


def names_of(mode: str) -> list[str]:
    """Dotted names of all settings with one way of making levels."""
    return [name for name, _ in _leaves(_TYPED[mode](), "")]


def types_of(mode: str) -> dict[str, Any]:
    """The annotation of each setting by its dotted name."""
    return dict(_annotated(_TYPED[mode], ""))


def _leaves(part: object, above: str) -> Iterator[tuple[str, Any]]:
    for entry in fields(cast("Any", part)):
        value, name = getattr(part, entry.name), f"{above}{entry.name}"
        if is_dataclass(value):
            yield from _leaves(value, f"{name}.")
        else:
            yield name, value


ALL_NAMES = list(dict.fromkeys([*names_of("joint"), *names_of("sequential")]))
"""Dotted names of all settings."""


def _check_names(values: Mapping[str, Any], mode: str) -> None:
    known = names_of(mode)
    for name, _ in _given(values, ""):
        if name in known:
            continue
        if name in ALL_NAMES:
            other = "sequential" if mode == "joint" else "joint"
            advice = f"it is a setting of {other} levels: give --levels {other}"
            raise SettingError(option_of(name), found=f"{mode} levels", advice=advice)
        group = name.rpartition(".")[0]
        near = [n.rpartition(".")[2] for n in known if n.rpartition(".")[0] == group]
        raise SettingError(f"--{name}", found="no such setting", expected=", ".join(near) or known)


def _given(values: Mapping[str, Any], above: str) -> Iterator[tuple[str, Any]]:
    groups = {name.rpartition(".")[0] for name in ALL_NAMES} | {"train"}
    for key, value in values.items():
        name = f"{above}{key}"
        if isinstance(value, Mapping) and name in groups:
            yield from _given(cast("Mapping[str, Any]", value), f"{name}.")
        else:
            yield name, value


def _explained(error: msgspec.ValidationError, values: Mapping[str, Any]) -> SettingError:
    """Msgspec's message, as `Expected `int` >= 1 - at `$.model.slots`, in our form."""
    text, _, place = str(error).partition(" - at ")
    name = re.sub(r"\[.*", "", place.strip("`").removeprefix("$").removeprefix("."))
    found: Any = values
    for key in name.split("."):
        found = found.get(key) if isinstance(found, Mapping) else found
    expected = text.replace("`", "").removeprefix("Expected ")
    if text.startswith("Invalid enum value"):
        expected = " or ".join(_choices(name))
    return SettingError(option_of(name), found=repr(found), expected=expected)


def _choices(name: str) -> list[str]:
    hint = (types_of("joint") | types_of("sequential")).get(name)
    return list(map(str, get_args(hint)))


def _annotated(part: Any, above: str) -> Iterator[tuple[str, Any]]:
    for name, hint in get_type_hints(part, include_extras=True).items():
        if is_dataclass(hint):
            yield from _annotated(hint, f"{above}{name}.")
        else:
            yield f"{above}{name}", hint


def _check_together(config: Config) -> None:
    levels, model = config.levels, config.model
    if isinstance(levels, Joint) and levels.level_mib:
        ordered = levels.level_mib
        fits = all(a < b for a, b in pairwise(ordered)) and len(ordered) == levels.count
        _expect("levels.level_mib", list(ordered), fits, f"{levels.count} rising sizes above 0")
    some = model.feature == "free" or model.grids + model.codebook + model.residual > 0
    _expect("model.residual", 0, some, "1 or more, as grids and codebook are 0")


def _expect(name: str, found: object, holds: bool, expected: str) -> None:
    if not holds:
        raise SettingError(option_of(name), found=found, expected=expected)
