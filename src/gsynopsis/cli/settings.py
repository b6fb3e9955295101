"""Options that become a `Config`: preset, the common ones by name, and `--set` for the rest."""

import dataclasses
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Annotated, Any, Literal, cast

from tyro.conf import UseAppendAction

from gsynopsis.cli.defaults import of_presets, said
from gsynopsis.cli.ranges import check_config
from gsynopsis.config import Config, preset, with_steps
from gsynopsis.errors import SettingError

NOT_BY_SET = ("preset",)
"""Settings that would only rename a run."""


@dataclass(frozen=True)
class Overrides:
    """What a command line may change of a preset; None keeps the preset's value.

    Attributes:
        steps: Steps of the full training; those of the levels scale along.
        seed: Seed of everything random.
        feature: `synopsis` (grids and codebook) or `free` (32 plain values per anchor, control).
        fusion: `mlp` as in the paper, or `none`.
        levels: `sequential` (the paper's unfolding) or `joint`.
        keep: Share of anchors kept from each level to the next coarser one, finest first.
        level_mib: Sizes to order: MiB of the file up to each level's end, coarsest first.
        ablation: Which parts adapt per level, sequential only.
        batch: Views per step, whose gradients are averaged; shared by the processes of torchrun.
        max_anchors: No growth beyond this many anchors.
        set: Any other settings, as `model.table_log2=15`; names as in `config.py`.
    """

    steps: Annotated[int | None, of_presets("train.steps")] = None
    seed: Annotated[int | None, of_presets("train.seed")] = None
    feature: Annotated[Literal["synopsis", "free"] | None, of_presets("model.feature")] = None
    fusion: Annotated[Literal["mlp", "none"] | None, of_presets("model.fusion")] = None
    levels: Annotated[Literal["sequential", "joint"] | None, of_presets("levels.mode")] = None
    keep: Annotated[tuple[float, ...] | None, of_presets("levels.keep")] = None
    level_mib: Annotated[tuple[float, ...] | None, said("as --keep gives them")] = None
    ablation: Annotated[
        Literal["full", "base", "lad", "cbm", "lad-frozen"] | None, of_presets("levels.ablation")
    ] = None
    batch: Annotated[int | None, of_presets("train.batch")] = None
    max_anchors: Annotated[int | None, of_presets("train.growth.max_anchors")] = None
    set: Annotated[tuple[tuple[str, ...], ...], UseAppendAction] = ()


def build_config(name: str, scale: float, split: str, overrides: Overrides) -> Config:
    """A preset with the changes of a command line.

    Raises:
        SettingError: an unknown name or a value that cannot be.
    """
    config = replaced(replaced(preset(name), "scale", scale), "split", split)
    if overrides.steps is not None:
        config = with_steps(config, overrides.steps)
    return apply_overrides(config, overrides)


def apply_overrides(config: Config, overrides: Overrides) -> Config:
    """All changes but `steps`, which means another thing to every command; checked.

    Raises:
        SettingError: an unknown name or a value that cannot be.
    """
    named: dict[str, Any] = {
        "train.seed": overrides.seed,
        "model.feature": overrides.feature,
        "model.fusion": overrides.fusion,
        "levels.mode": overrides.levels,
        "levels.keep": overrides.keep,
        "levels.level_mib": overrides.level_mib,
        "levels.ablation": overrides.ablation,
        "train.batch": overrides.batch,
        "train.growth.max_anchors": overrides.max_anchors,
    }
    for key, value in named.items():
        if value is not None:
            config = replaced(config, key, value)
    if overrides.level_mib and overrides.keep is None:
        # The bytes decide; these are only as many levels as were ordered.
        shares = config.levels.keep + (0.5,) * len(overrides.level_mib)
        config = replaced(config, "levels.keep", shares[: len(overrides.level_mib) - 1])
    for text in chain.from_iterable(overrides.set):
        key, equals, value = text.partition("=")
        if not equals:
            raise SettingError("--set", found=text, expected="name=value")
        if key.strip() in NOT_BY_SET:
            advice = "it decides many settings: give the option --preset"
            raise SettingError("--set", key.strip(), found=value, advice=advice)
        config = replaced(config, key.strip(), _literal(value.strip()))
    check_config(config)
    return config


def replaced(config: Any, key: str, value: Any, above: str = "") -> Any:
    """A copy of nested dataclasses with the dotted field changed; `above` is for messages.

    Raises:
        SettingError: there is no such field, or the value has another type than its default.
    """
    head, _, rest = key.partition(".")
    names = [field.name for field in dataclasses.fields(config)]
    path = f"{above}{head}"
    if head not in names:
        raise SettingError("--set", path, found="no such setting", expected=", ".join(names))
    current = getattr(config, head)
    if rest:
        if not dataclasses.is_dataclass(current):
            raise SettingError("--set", path, found="a part of it", expected="the whole")
        return replace(config, **{head: replaced(current, rest, value, f"{path}.")})
    return replace(config, **{head: _like(current, value, path)})


def config_from_dict(config: Any, values: dict[str, Any]) -> Any:
    """Settings as a run's record holds them, put on top of `config`.

    Raises:
        SettingError: a name or a type does not fit.
    """
    for name, value in values.items():
        if isinstance(value, dict) and dataclasses.is_dataclass(getattr(config, name, None)):
            inner = config_from_dict(getattr(config, name), cast("dict[str, Any]", value))
            config = replace(config, **{name: inner})
        else:
            config = replaced(config, name, value)
    return config


def _literal(text: str) -> Any:
    for read in (json.loads, float):  # JSON knows no .5
        try:
            return read(text)
        except (ValueError, RecursionError):
            continue
    return text


def _like(current: Any, value: Any, key: str) -> Any:
    """The value as the type of the default, or a refusal."""
    given: object = value
    if isinstance(current, tuple) and isinstance(given, list | tuple):
        numbers = cast("Sequence[object]", given)
        if all(_is_number(v) for v in numbers):
            return tuple(_float(cast("float", v)) for v in numbers)
    elif isinstance(current, float):
        if _is_number(given):
            return _float(cast("float", given))
    elif type(given) is type(cast("object", current)):
        return value
    raise SettingError("--set", key, found=repr(value), expected=f"a value like {current!r}")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _float(value: float) -> float:
    """The value as float64; infinite where a whole number is too long for that."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf
