"""Settings of a training: a preset, what was asked for, and what follows from the scene."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from gsynopsis.config import (
    Config,
    PresetName,
    Recipe,
    preset_value,
    replaced,
    resolve_settings,
)
from gsynopsis.errors import SettingError
from gsynopsis.model.build import photo_cell
from gsynopsis.scene.scene import Scene


def resolve(
    preset: str = "standard",
    scene: Scene | int | None = None,
    asked: Mapping[str, Any] | None = None,
) -> Recipe:
    """The settings of a training: a preset, what was asked for, what follows from the scene.

    Args:
        preset: `draft`, `standard`, `high` or `max`, our own anchor model, trained ever longer, or
            `paper` (the paper's model and values).
        scene: The scene, or how many training photos there are; None: nothing follows from it.
        asked: Values by dotted name, as `{"train.steps": 300}`; they always win.

    Raises:
        SettingError: there is no such preset or setting, or a value cannot be.

    Examples:
        >>> scene = gs.load_scene("scene")
        >>> recipe = gs.resolve("standard", scene, {"train.steps": 30, "levels.steps": 50})
        >>> recipe.config.train.steps, recipe.config.levels.keep
        (30, (0.7, 0.5, 0.4))
    """
    asked = dict(asked or {})
    if not isinstance(scene, Scene):
        return resolve_settings(preset, scene, asked)
    split = asked.get("split", scene.split)
    if split != preset_value("split", preset):
        asked["split"] = split
    if split != scene.split:
        advice = f"load it so: load_scene(path, split={split!r})"
        found = f"a scene split by {scene.split}"
        raise SettingError("split", found=found, expected=split, advice=advice)
    scale = asked.get("scale", preset_value("scale", preset))
    cell, side = None, 0
    if isinstance(scale, int | float) and scale >= 1:
        cell = photo_cell(scene, scale)
        cameras = (scene.camera(view) for view in scene.train)
        side = max(min(camera.width, camera.height) for camera in cameras) / scale
    recipe = resolve_settings(preset, len(scene.train), asked, cell, len(scene.points), side)
    settings = recipe.config.train
    if settings.exposure == "on" and settings.batch > 1:
        expected = "--batch 1: exposure is solved from one view per step"
        raise SettingError("--batch", found=settings.batch, expected=expected)
    return recipe


def unfolded(config: Config, asked: Mapping[str, Any], preset: PresetName) -> Recipe:
    """The settings of a run with other levels.

    Raises:
        SettingError: a setting of the full model was to be changed, or a value cannot be.
    """
    asked = dict(asked)
    mode = asked.get("levels.mode", config.levels.mode)
    if mode != config.levels.mode:
        # The other way of making levels has settings of its own: the preset's, same shares kept.
        other = resolve_settings(preset, None, {"levels.mode": mode}).config.levels
        config = replace(config, levels=replace(other, keep=config.levels.keep))
    ordered = asked.get("levels.level_mib")
    if ordered and "levels.keep" not in asked:
        asked["levels.keep"] = resolve_settings(preset, None, asked).config.levels.keep
    changed = replaced(config, asked)
    if (changed.model, changed.train) != (config.model, config.train):
        advice = "train another run"
        raise SettingError("unfold", found="a change of the full model", advice=advice)
    return Recipe(preset, changed, frozenset(asked))
