"""What the help says in place of `(default: None)`."""

from functools import reduce
from typing import Any, cast

from tyro.conf import arg

from gsynopsis.config import PRESETS


def said(text: str) -> Any:
    """A marker for an option: the help calls its default so."""
    return arg(help_behavior_hint=f"(default: {text})")


def of_presets(name: str) -> Any:
    """The same with the values that a setting has in the presets, as `1500 in fast`.

    Args:
        name: Dotted, as in `config.py`.
    """
    return said(preset_values(name))


def preset_values(name: str) -> str:
    """A setting's value in each preset; once where all have the same."""
    found: dict[str, list[str]] = {}
    for preset, make in reversed(PRESETS.items()):
        value: Any = reduce(getattr, name.split("."), make())
        values = cast("tuple[object, ...]", value) if isinstance(value, tuple) else (value,)
        text = " ".join(map(str, values))
        found.setdefault(text, []).append(preset)
    if len(found) == 1:
        return next(iter(found))
    return ", ".join(f"{text} in {' and '.join(presets)}" for text, presets in found.items())
