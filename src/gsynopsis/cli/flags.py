"""Options for all settings, made from their dataclasses: `--train.growth.threshold`, `--steps`.

Every option is absent unless it is given, so what was asked for is known and never guessed. Help
comes from the docstrings of the fields in `config/settings.py`.
"""

import ast
import inspect
import json
from collections.abc import Iterator, Mapping
from dataclasses import field, fields, is_dataclass, make_dataclass
from itertools import chain, pairwise
from textwrap import dedent
from typing import TYPE_CHECKING, Annotated, Any, cast, get_type_hints

from tyro.conf import UseAppendAction, arg

from gsynopsis.config import (
    LEVELS,
    PRESETS,
    GrowthConfig,
    ModelConfig,
    TrainConfig,
    preset_value,
)
from gsynopsis.config.serialize import OPTIONS
from gsynopsis.errors import SettingError


def asked_of(given: "Overrides") -> dict[str, Any]:
    """The settings that were given, by dotted name.

    Raises:
        SettingError: `--set` without a value.
    """
    found = dict(_given(given, ""))
    for text in chain.from_iterable(found.pop("set", ())):
        name, equals, value = text.partition("=")
        if not equals:
            raise SettingError("--set", found=text, expected="name=value")
        found[name.strip()] = _literal(value.strip())
    return found


def to_set_flags(asked: Mapping[str, Any]) -> "Overrides":
    """The options that give these settings by `--set`; the inverse of `asked_of`."""
    words = tuple((f"{name}={json.dumps(value)}",) for name, value in asked.items())
    return Overrides(set=words)


def preset_values(name: str) -> str:
    """A setting's value in each preset: `1500 in standard; 375 in draft`, or one for all."""
    found: dict[str, list[str]] = {}
    for preset in PRESETS:
        value = preset_value(name, preset)
        if value is not None:
            values = cast("tuple[object, ...]", value) if isinstance(value, tuple) else (value,)
            found.setdefault(" ".join(map(str, values)), []).append(preset)
    if len(found) == 1:
        return next(iter(found))
    named = {text: ", ".join(presets[:-1]) for text, presets in found.items()}
    return "; ".join(
        f"{text} in {' and '.join(filter(None, [named[text], presets[-1]]))}"
        for text, presets in found.items()
    )


def overrides(name: str, kept: str | None = None) -> type[Any]:
    """A dataclass with an option for every setting; absent ones are None.

    Args:
        name: Of the class.
        kept: What the help says in place of the presets' values, as "the run's".
    """
    levels = _group("LevelsFlags", "levels", tuple(LEVELS.values()), kept, {})
    growth = _group("GrowthFlags", "train.growth", (GrowthConfig,), kept, {})
    train = _group("TrainFlags", "train", (TrainConfig,), kept, {"growth": growth})
    model = _group("ModelFlags", "model", (ModelConfig,), kept, {})
    more = arg(help="Settings by name, as levels.prune_share=0.")
    return make_dataclass(
        name,
        [
            ("model", model, field(default_factory=model)),
            ("train", train, field(default_factory=train)),
            ("levels", levels, field(default_factory=levels)),
            (
                "set",
                Annotated[tuple[tuple[str, ...], ...], UseAppendAction, more],
                field(default=()),
            ),
        ],
        frozen=True,
        namespace={"__doc__": "Settings to change; all others are the preset's."},
    )


def _group(
    name: str,
    above: str,
    sources: tuple[type[Any], ...],
    kept: str | None,
    inner: Mapping[str, type[Any]],
) -> type[Any]:
    """Options for the fields of settings classes; fields of one name are one option."""
    made: dict[str, tuple[str, Any, Any]] = {}
    for source in sources:
        hints, texts = get_type_hints(source, include_extras=True), field_docs(source)
        for entry in fields(source):
            if entry.name in made or is_dataclass(hints[entry.name]):
                continue
            dotted = f"{above}.{entry.name}"
            hint = str if entry.name == "mode" else hints[entry.name]
            made[entry.name] = (entry.name, _option(dotted, hint, texts, kept), field(default=None))
    if above == "levels":
        modes = "How levels are made: joint (ours, all at once) or sequential (the paper's)."
        hint = _option("levels.mode", str, {"mode": modes}, kept)
        made["mode"] = ("mode", hint, field(default=None))
    groups = [(n, kind, field(default_factory=kind)) for n, kind in inner.items()]
    return make_dataclass(name, [*made.values(), *groups], frozen=True)


def _option(dotted: str, hint: Any, texts: Mapping[str, str], kept: str | None) -> Any:
    short = OPTIONS.get(dotted)
    marks = arg(
        help=texts.get(dotted.rpartition(".")[2], "").replace("\n", " "),
        help_behavior_hint=f"(default: {kept or preset_values(dotted)})",
        aliases=(short,) if short else None,
    )
    return Annotated[hint | None, marks]


def field_docs(kind: type[Any]) -> dict[str, str]:
    """The docstring below each field of a class."""
    body = cast("ast.ClassDef", ast.parse(dedent(inspect.getsource(kind))).body[0]).body
    found: dict[str, str] = {}
    for statement, below in pairwise(body):
        target = statement.target if isinstance(statement, ast.AnnAssign) else None
        text = below.value if isinstance(below, ast.Expr) else None
        if isinstance(target, ast.Name) and isinstance(text, ast.Constant):
            found[target.id] = inspect.cleandoc(str(text.value))
    return found


def _given(part: Any, above: str) -> Iterator[tuple[str, Any]]:
    for entry in fields(part):
        value = getattr(part, entry.name)
        if is_dataclass(value):
            yield from _given(value, f"{above}{entry.name}.")
        elif value is not None:
            yield f"{above}{entry.name}", value


def _literal(text: str) -> Any:
    for read in (json.loads, float):  # JSON knows no .5
        try:
            return read(text)
        except (ValueError, RecursionError):
            continue
    return text


if TYPE_CHECKING:

    class Overrides:
        """Settings of a new training; an attribute for each, absent ones None."""

        def __init__(self, *, set: tuple[tuple[str, ...], ...] = ()) -> None:
            """Only `--set`."""
            ...

    class Changes(Overrides):
        """Settings of levels that are made again."""
else:
    Overrides = overrides("Overrides")
    Changes = overrides("Changes", kept="the run's")
