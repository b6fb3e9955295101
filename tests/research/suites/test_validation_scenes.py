"""Procedural scenes by name."""

from dataclasses import replace
from pathlib import Path

import pytest

from gsynopsis.errors import SettingError
from gsynopsis.scene.load import load_scene
from research.suites import validation_scenes as procedural
from research.suites.validation_scenes import PROCEDURAL, procedural_scene


def test_a_scene_is_made_once_and_again_when_its_recipe_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = replace(PROCEDURAL["tiny"], views=8, width=16, height=12, points=30)
    monkeypatch.setitem(PROCEDURAL, "tiny", small)
    folder = procedural_scene("tiny", tmp_path)
    assert len(load_scene(folder, "validation").test) == 1
    made = (folder / "synthetic.json").stat().st_mtime_ns
    assert procedural_scene("tiny", tmp_path) == folder
    assert (folder / "synthetic.json").stat().st_mtime_ns == made
    monkeypatch.setitem(PROCEDURAL, "tiny", replace(small, views=5))
    assert len(load_scene(procedural_scene("tiny", tmp_path)).views) == 5


def test_an_unknown_one_is_one_line_with_all_names(tmp_path: Path) -> None:
    with pytest.raises(SettingError, match="found moon, expected indoor or outdoor"):
        procedural_scene("moon", tmp_path)
    assert procedural.PROCEDURAL["object"].kind == "object"
