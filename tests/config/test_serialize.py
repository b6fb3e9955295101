"""Settings as JSON and by dotted names."""

import json
from typing import Any

import pytest

from gsynopsis.config import (
    PRESETS,
    Joint,
    Sequential,
    config_from_json,
    config_to_json,
    preset_of,
    resolve_settings,
    values_of,
)
from gsynopsis.config.serialize import ALL_NAMES
from gsynopsis.errors import SettingError


@pytest.mark.parametrize("mode", ["joint", "sequential"])
@pytest.mark.parametrize("name", list(PRESETS))
def test_settings_come_back_from_json_unchanged(name: str, mode: str) -> None:
    config = resolve_settings(name, 20, {"levels.mode": mode}).config
    assert config_from_json(config_to_json(config)) == config
    assert isinstance(config.levels, Joint if mode == "joint" else Sequential)
    assert list(values_of(config)) == sorted(values_of(config))


def test_names_are_dotted_and_all_there() -> None:
    assert "train.growth.threshold" in ALL_NAMES and len(set(ALL_NAMES)) == len(ALL_NAMES)


@pytest.mark.parametrize(
    "change", [{"scale": 0}, {"model": 5}, {"model": {"slots": "many"}}, {"a": {"b": 1}}]
)
def test_json_that_was_edited_is_refused_as_an_option_is(change: dict[str, Any]) -> None:
    with pytest.raises(SettingError):
        config_from_json(json.dumps(values_of(preset_of("standard").config) | change))
