"""Annotations as a note of the manifest: titles and texts at places, each with a view of it."""

import json
import math
from pathlib import Path
from typing import Any, cast

from gsynopsis.container.layout import FAR
from gsynopsis.errors import InputError

ANNOTATIONS_MAX = 100
TITLE_MAX, TEXT_MAX = 100, 2000
"""Characters."""
VIEW = {"position": 3, "target": 3, "quaternion": 4}
"""Members of an annotation's camera, and how many numbers each has."""


def annotations_text(content: str, source: Path | str) -> str:
    """Annotations as the text of the note; empty for an empty list.

    Args:
        content: JSON of the form of docs/format.md.
        source: What messages call it.

    Raises:
        InputError: it is not of that form.
    """
    try:
        values = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise InputError(source, found=error, expected="JSON") from error
    if not isinstance(values, list) or len(cast(list[object], values)) > ANNOTATIONS_MAX:
        expected = f"a list of at most {ANNOTATIONS_MAX} annotations"
        raise InputError(source, found=f"{values!r:.40}", expected=expected)
    notes = [_annotation(value, k, source) for k, value in enumerate(cast(list[object], values))]
    text = json.dumps(notes, ensure_ascii=False, separators=(",", ":"))
    return text if notes else ""


def _annotation(value: object, number: int, source: Path | str) -> dict[str, Any]:
    where = f"annotation {number}"
    given = _object(value, where, source)
    camera = _object(given.get("camera"), f"{where}: camera", source)
    return {
        "title": _words(given.get("title"), TITLE_MAX, f"{where}: title", source),
        "text": _words(given.get("text", ""), TEXT_MAX, f"{where}: text", source),
        "at": _numbers(given.get("at"), 3, f"{where}: at", source),
        "camera": {
            name: _numbers(camera.get(name), count, f"{where}: {name}", source)
            for name, count in VIEW.items()
        },
    }


def _object(value: object, field: str, source: Path | str) -> dict[str, object]:
    if not isinstance(value, dict):
        raise InputError(source, field, found=f"{value!r:.40}", expected="an object")
    return cast(dict[str, object], value)


def _words(value: object, most: int, field: str, source: Path | str) -> str:
    if not isinstance(value, str) or len(value) > most:
        expected = f"text of at most {most} characters"
        raise InputError(source, field, found=f"{value!r:.40}", expected=expected)
    return value.encode(errors="replace").decode()


def _numbers(value: object, count: int, field: str, source: Path | str) -> list[float]:
    numbers = cast(list[object], value) if isinstance(value, list) else []
    sound = len(numbers) == count and all(
        isinstance(n, int | float)
        and not isinstance(n, bool)
        and math.isfinite(n)
        and abs(n) <= FAR
        for n in numbers
    )
    if not sound:
        raise InputError(source, field, found=f"{value!r:.40}", expected=f"{count} numbers")
    return [float(cast(float, n)) for n in numbers]
