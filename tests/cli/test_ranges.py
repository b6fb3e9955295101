"""Settings are refused before a training, or never."""

import dataclasses
import json
import math
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest

from gsynopsis.cli.ranges import check_config
from gsynopsis.cli.run_folder import Run
from gsynopsis.cli.settings import Overrides, build_config, replaced
from gsynopsis.cli.training import recorded_config
from gsynopsis.config import PRESETS, Config, ModelConfig, Range, preset
from gsynopsis.errors import InputError, SettingError
from gsynopsis.pack import layout


def ranges(part: Any, above: str = "") -> Iterator[tuple[str, Any, Range]]:
    """Dotted name, default and range of every setting that has one."""
    hints = get_type_hints(type(part), include_extras=True)
    for field in dataclasses.fields(part):
        value, kinds = getattr(part, field.name), get_args(hints[field.name])
        if dataclasses.is_dataclass(value):
            yield from ranges(value, f"{above}{field.name}.")
        elif len(kinds) > 1 and isinstance(kinds[1], Range):
            yield f"{above}{field.name}", value, kinds[1]


RANGES = list(ranges(Config()))


@pytest.mark.parametrize("name", list(PRESETS))
def test_presets_are_in_their_ranges(name: str) -> None:
    check_config(preset(name))
    assert len(RANGES) > 60


def test_every_number_has_a_range() -> None:
    """A new setting cannot forget it."""
    numbers = [
        name
        for name, value in _leaves(asdict(Config()), "")
        if isinstance(value, int | float | tuple) and not isinstance(value, bool)
    ]
    assert sorted(numbers) == sorted(name for name, _, _ in RANGES)


def _leaves(values: dict[str, Any], above: str) -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", value


@pytest.mark.parametrize(("name", "default", "limits"), RANGES, ids=[name for name, *_ in RANGES])
def test_what_lies_beyond_an_end_is_refused(name: str, default: Any, limits: Range) -> None:
    whole = isinstance(default, int)
    step = 1 if whole else max(1e-6, abs(limits.low) * 1e-6)
    outside = [limits.low - step]
    outside += [limits.high + (1 if whole else limits.high * 1e-6)] * math.isfinite(limits.high)
    outside += [limits.low] * (limits.open == "low") + [limits.high] * (limits.open == "high")
    outside += [] if whole else [math.nan, math.inf, -math.inf]
    for value in outside:
        given = (value,) * max(1, limits.counts[0]) if isinstance(default, tuple) else value
        changed = replaced(Config(), name, int(value) if whole else given)
        with pytest.raises(SettingError, match=r"found .*, expected"):
            check_config(changed)


def test_ranges_are_within_what_a_file_can_hold() -> None:
    fields = layout.fields_of(layout.LevelEntry) | {
        "slots": layout.fields_of(layout.Header)["slots"],
        "residual_values": layout.fields_of(layout.Header)["residual"],
    }
    pairs = {
        "slots": "slots",
        "residual": "residual_values",
        "hidden": "head_hidden",
        "fuse_hidden": "fuse_hidden",
        "fuse_out": "fuse_out",
        "codebook": "codebook_rows",
        "codebook_dim": "codebook_columns",
        "grids": "grids",
    }
    own = {name: limits for name, _, limits in ranges(ModelConfig())}
    for name, field in pairs.items():
        assert own[name].high <= fields[field].high, name
    most = {name: limits for name, _, limits in RANGES}
    assert most["train.growth.max_anchors"].high <= fields["anchors"].high
    assert most["levels.keep"].counts[1] + 1 <= layout.fields_of(layout.Header)["levels"].high


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("model.hidden=5000", "model.hidden: found 5000, expected 1 to 4,096"),
        ("model.hidden=0", "model.hidden: found 0"),
        ("model.residual=2000", "model.residual: found 2000, expected 0 to 1,024"),
        ("model.voxel=-1", "model.voxel: found -1"),
        ("model.voxel=" + "9" * 400, "model.voxel: found inf"),
        ("split=nope", "--split: found nope, expected every8 or bungee or none"),
        ("levels.mode=both", "levels.mode: found both, expected sequential or joint"),
        ("train.seed=-1", "--seed: found -1, expected 0 to 9,223,372,036,854,775,807"),
        (f"train.seed={2**63}", "--seed: found 9223372036854775808"),
        ("train.steps=" + "1" * 31, "--steps: found 1111"),
        ("train.rates.offset=[0.1]", "train.rates.offset: found (0.1,), expected 2 numbers"),
        ("train.rates.offset=[true, false]", "expected a value like (0.01, 0.002)"),
        ("model.slots=" + "[" * 100_000, "model.slots: found '[[["),
        ("train.growth.max_anchors=-1", "--max-anchors: found -1, expected 1 to"),
        ("levels.level_mib=[0.1, 0.2, 0.3, Infinity]", "--level-mib: found (0.1, 0.2, 0.3, inf)"),
        ("preset=paper", "--set: preset: found paper; it decides many settings: give the option"),
    ],
)
def test_settings_that_failed_at_the_end_are_refused_at_the_start(
    given: str, expected: str
) -> None:
    with pytest.raises(SettingError) as caught:
        build_config("fast", 1.0, "every8", Overrides(set=((given,),)))
    assert expected in str(caught.value)


@pytest.mark.parametrize("scale", [0.5, -1.0, math.inf, math.nan])
def test_a_scale_that_is_no_divisor_is_refused(scale: float) -> None:
    with pytest.raises(SettingError, match="--scale: found"):
        build_config("fast", scale, "every8", Overrides())


@pytest.mark.parametrize("steps", [0, -5, 10**9, 10**400])
def test_steps_without_end_are_refused(steps: int) -> None:
    with pytest.raises(SettingError, match="--steps: found"):
        build_config("fast", 1.0, "every8", Overrides(steps=steps))


@pytest.mark.parametrize(
    "change",
    [{"scale": 0}, {"model": 5}, {"model": {"slots": "many"}}, {"a": {"b": 1}}, {"split": "x"}],
)
def test_a_record_that_was_edited_is_refused_as_an_option_is(tmp_path: Path, change: Any) -> None:
    values = json.loads(json.dumps(asdict(preset("fast")))) | change
    (tmp_path / "run.json").write_text(json.dumps({"config": values}))
    with pytest.raises(InputError):
        recorded_config(Run(tmp_path / "scene.gsyn", tmp_path))
    good = json.dumps({"config": asdict(replace(preset("ours"), scale=4.0))})
    (tmp_path / "run.json").write_text(good)
    assert recorded_config(Run(tmp_path / "scene.gsyn", tmp_path)).scale == 4
