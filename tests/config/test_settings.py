"""Settings are refused before a training, or never; records of earlier versions are read."""

import math
from collections.abc import Iterator
from typing import Any, get_args

import msgspec
import pytest

from gsynopsis.config import (
    PRESETS,
    Config,
    preset_of,
    replaced,
    resolve_settings,
)
from gsynopsis.config.serialize import get, names_of, types_of
from gsynopsis.container import layout
from gsynopsis.errors import SettingError


def limits_of(hint: Any) -> msgspec.Meta | None:
    """The range of a number, or of each number of a tuple."""
    kind, *marks = get_args(hint) if hasattr(hint, "__metadata__") else (hint,)
    for mark in marks:
        if isinstance(mark, msgspec.Meta) and any(
            end is not None for end in (mark.ge, mark.gt, mark.le, mark.lt)
        ):
            return mark
    inner = get_args(kind)
    return limits_of(inner[0]) if inner and hasattr(inner[0], "__metadata__") else None


RANGES = {
    (mode, name): limits
    for mode in ("joint", "sequential")
    for name, hint in types_of(mode).items()
    if (limits := limits_of(hint)) is not None
}


def start(mode: str) -> Config:
    return resolve_settings("standard", None, {"levels.mode": mode}).config


def test_every_number_has_a_range_with_two_ends() -> None:
    """A new setting cannot forget it."""
    for mode in ("joint", "sequential"):
        for name in names_of(mode):
            value = get(start(mode), name)
            if isinstance(value, int | float | tuple) and not isinstance(value, bool):
                limits = RANGES[mode, name]
                assert limits.ge is not None or limits.gt is not None, name
                assert limits.le is not None or limits.lt is not None, name


def outside(limits: msgspec.Meta, whole: bool) -> Iterator[float]:
    low = limits.ge if limits.ge is not None else limits.gt
    high = limits.le if limits.le is not None else limits.lt
    assert low is not None and high is not None
    yield low - (1 if whole else max(1e-6, abs(low) * 1e-6))
    yield high + (1 if whole else high * 1e-6)
    yield from [low] * (limits.gt is not None) + [high] * (limits.lt is not None)
    yield from [] if whole else [math.nan, math.inf, -math.inf]


@pytest.mark.parametrize(("mode", "name"), RANGES, ids=[f"{m}-{n}" for m, n in RANGES])
def test_what_lies_beyond_an_end_is_refused(mode: str, name: str) -> None:
    default = get(start(mode), name)
    whole = isinstance(default, int)
    for value in outside(RANGES[mode, name], whole):
        given = [value] if isinstance(default, tuple) else int(value) if whole else value
        with pytest.raises(SettingError, match=r"found .*, expected"):
            resolve_settings("standard", None, {"levels.mode": mode, name: given})


@pytest.mark.parametrize("name", list(PRESETS))
def test_presets_are_in_their_ranges(name: str) -> None:
    assert replaced(preset_of(name).config, {}) == preset_of(name).config


def test_ranges_are_within_what_a_file_can_hold() -> None:
    header, level = layout.fields_of(layout.Header), layout.fields_of(layout.LevelEntry)
    fields = {
        "model.slots": header["slots"],
        "model.residual": header["residual"],
        "model.hidden": level["head_hidden"],
        "model.codebook": level["codebook_rows"],
        "model.grids": level["grids"],
        "train.growth.max_anchors": level["anchors"],
    }
    for name, field in fields.items():
        most = RANGES["joint", name].le
        assert most is not None and most <= field.high, name
    with pytest.raises(SettingError):
        resolve_settings("standard", None, {"levels.keep": [0.5] * header["levels"].high})


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("model.hidden", 5000, "--model.hidden: found 5000, expected int <= 4096"),
        ("model.hidden", 0, "--model.hidden: found 0, expected int >= 1"),
        ("model.hidden", 2.5, "--model.hidden: found 2.5, expected int, got float"),
        ("model.hidden", True, "--model.hidden: found True"),
        ("model.voxel", -1, "--model.voxel: found -1"),
        ("model.voxel", 10**400, "--model.voxel: found 1000"),
        ("split", "nope", "--split: found 'nope', expected every8 or validation or bungee or none"),
        ("train.seed", -1, "--seed: found -1"),
        ("train.seed", 2**63, "--seed: found 9223372036854775808"),
        ("train.steps", 10**30, "--steps: found 1000"),
        ("train.growth.max_anchors", -1, "--max-anchors: found -1, expected int >= 1"),
        ("levels.level_mib", [0.1, 0.2, 0.3, math.inf], "--level-mib: found [0.1"),
        ("scale", math.nan, "--scale: found nan"),
        ("preset", "paper", "preset: found paper; it decides many settings"),
    ],
)
def test_what_no_training_can_use_is_refused_by_its_option(
    name: str, value: Any, expected: str
) -> None:
    with pytest.raises(SettingError) as caught:
        resolve_settings("standard", None, {name: value})
    assert str(caught.value).startswith(expected)
    assert "\n" not in str(caught.value)


def test_a_model_needs_features() -> None:
    with pytest.raises(SettingError, match=r"--model\.residual: found 0"):
        resolve_settings("standard", None, {"model.residual": 0})
    assert resolve_settings("standard", None, {"model.residual": 0, "model.feature": "free"})
