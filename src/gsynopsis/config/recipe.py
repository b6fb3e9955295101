"""A preset, what was asked, and what follows from the scene: resolved into one `Recipe`."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, cast

from gsynopsis.config.presets import Preset, PresetName, preset_of
from gsynopsis.config.scene_rules import BY_POINTS, MANY_POINTS, adapt, facts_of, step_factor
from gsynopsis.config.serialize import (
    ALL_NAMES,
    Values,
    config_from_values,
    get,
    option_of,
    put,
    replaced,
)
from gsynopsis.config.settings import Config, total_steps
from gsynopsis.errors import SettingError

ORDERED_KEEP = 0.5
"""Share of anchors kept per step down where the bytes decide (`levels.level_mib`)."""


@dataclass(frozen=True)
class Recipe:
    """Settings of a training, resolved: nothing in it depends on anything else any more.

    Attributes:
        preset: Where the settings come from; one of `PRESETS`.
        config: All settings.
        asked: Dotted names of those that were asked for: they are as asked, whatever the scene.
        followed: Why a setting is not the preset's, by dotted name: "60 photos, 4,000 steps".

    Examples:
        >>> recipe = gs.resolve("standard", asked={"train.steps": 300})
        >>> recipe
        Recipe(standard: levels.steps 500, train.steps 300)
        >>> recipe.source("train.steps"), recipe.source("model.slots")
        ('asked for', 'preset standard')
        >>> recipe.config.levels.mode
        'joint'
    """

    preset: PresetName
    config: Config
    asked: frozenset[str] = frozenset()
    followed: Mapping[str, str] = field(default_factory=dict[str, str])

    def source(self, name: str) -> str:
        """Say where the value of a setting comes from.

        Args:
            name: Dotted, as `train.growth.threshold`.

        Raises:
            SettingError: there is no such setting.
        """
        if name not in ALL_NAMES:
            raise SettingError(name, found="no such setting")
        if name in self.asked:
            return "asked for"
        return self.followed.get(name, f"preset {self.preset}")

    def lines(self) -> list[str]:
        """Differences from the preset, a line each: `train.growth.threshold 8e-05: 60 photos`."""
        names = [*sorted(self.asked), *sorted(self.followed)]
        return [f"{name} {_shown(get(self.config, name))}: {self.source(name)}" for name in names]

    def __repr__(self) -> str:
        """The preset and what differs from it; `config` has all."""
        changed = (f"{name} {_shown(get(self.config, name))}" for name in self._changed())
        return f"Recipe({': '.join(filter(None, [self.preset, ', '.join(changed)]))})"

    def _repr_markdown_(self) -> str:
        """A table of what differs from the preset, for notebooks."""
        title = f"**{self.preset}**, {total_steps(self.config):,} steps in all"
        rows = [
            f"| `{name}` | {_shown(get(self.config, name))} | {self.source(name)} |"
            for name in self._changed()
        ]
        table = ["", "| setting | value | from |", "|---|---|---|", *rows] if rows else []
        return "\n".join([title, *table])

    def _changed(self) -> list[str]:
        return sorted({*self.asked, *self.followed})


def resolve_settings(
    preset: str,
    views: int | None = None,
    asked: Mapping[str, Any] | None = None,
    cell: float | None = None,
    points: int = MANY_POINTS,
    side: float = 0,
) -> Recipe:
    """The settings of a training; settings asked for always win.

    Args:
        preset: `draft`, `standard`, `high`, `max` or `paper`.
        views: Training photos; None where no scene is known: then nothing follows their number.
        asked: Values by dotted name, as `{"train.steps": 300, "levels.mode": "sequential"}`.
        cell: The lattice cell that the photos ask for, world units; None: the sparse points'.
        points: Sparse points of the scene; counts where `views` are known.
        side: Pixels across the largest photo at the training resolution; likewise. 0: unknown.

    Raises:
        SettingError: there is no such preset or setting, or a value cannot be.
    """
    chosen = preset_of(preset)
    wanted = dict(asked or {})
    if "preset" in wanted:
        advice = "it decides many settings: choose it as the preset"
        raise SettingError("preset", found=wanted["preset"], advice=advice)
    start = _start(chosen, wanted)
    followed = dict(_by_sizes(start, wanted))
    values: Values = asdict(start)
    for name, value in (*wanted.items(), *((n, v) for n, (v, _) in followed.items())):
        put(values, name, value)
    config = config_from_values(values)
    pixels = f"{views or 0:,} photos, {side:.0f} pixels across"
    if chosen.by_scene and views is not None and not {"train.steps", "levels.steps"} & set(wanted):
        steps = round(step_factor(config, views, side) * start.train.steps)
        if steps != start.train.steps:
            followed["train.steps"] = steps, pixels
            config = replaced(config, {"train.steps": steps})
    followed |= _by_steps(start, config, wanted)
    config = replaced(config, {name: value for name, (value, _) in followed.items()})
    if chosen.by_scene and cell is not None and "model.voxel" not in wanted:
        followed["model.voxel"] = (cell, "the size of the photos' pixels")
    if chosen.by_scene and views is not None:
        facts = facts_of(config, views, points, side)
        reason = f"{facts.views:,} photos, {facts.steps:,} steps"
        few = f", {points:,} points" if points < MANY_POINTS else ""
        reasons = dict.fromkeys(BY_POINTS, reason + few) | {"train.reduced_until": pixels}
        followed |= {
            name: (value, reasons.get(name, reason))
            for name, value in adapt(start, facts).items()
            if name not in wanted
        }
    config = replaced(config, {name: value for name, (value, _) in followed.items()})
    sources = {name: reason for name, (_, reason) in followed.items()}
    return Recipe(chosen.name, config, frozenset(wanted), sources)


def _start(chosen: Preset, wanted: Mapping[str, Any]) -> Config:
    """The preset with the way of making levels that is asked for."""
    mode = wanted.get("levels.mode", chosen.config.levels.mode)
    levels = {"joint": chosen.joint, "sequential": chosen.sequential}.get(str(mode))
    if levels is None:
        option = option_of("levels.mode")
        raise SettingError(option, found=repr(mode), expected="joint or sequential")
    return replace(chosen.config, levels=levels)


def _by_sizes(start: Config, wanted: Mapping[str, Any]) -> Mapping[str, tuple[Any, str]]:
    """One level for each size asked for; its number of anchors follows from the bytes."""
    ordered = wanted.get("levels.level_mib")
    if not ordered or not isinstance(ordered, list | tuple) or "levels.keep" in wanted:
        return {}
    sizes = cast("list[object]", ordered)
    shares = start.levels.keep + (ORDERED_KEEP,) * len(sizes)
    return {"levels.keep": (list(shares[: len(sizes) - 1]), f"{len(sizes)} sizes are ordered")}


def _by_steps(
    start: Config, config: Config, wanted: Mapping[str, Any]
) -> Mapping[str, tuple[Any, str]]:
    """Steps of levels in proportion to those of the full model."""
    if config.train.steps == start.train.steps or "levels.steps" in wanted:
        return {}
    steps = max(1, round(start.levels.steps * (config.train.steps / start.train.steps)))
    return {"levels.steps": (steps, f"{config.train.steps:,} steps of the full model")}


def _shown(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    return " ".join(map(_shown, value)) if isinstance(value, tuple) else str(value)


def preset_value(name: str, preset: str) -> Any:
    """A setting's value in a preset; None where its way of making levels has no such setting."""
    try:
        return get(preset_of(preset).config, name)
    except AttributeError:
        return None
