"""The manifest chunk: what people want to know about a file, as checked JSON.

`{"meta": {name: text, …}, "quality": [{name: number, …}, …]}`, one quality object per level.
"""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, NoReturn, cast

from gsynopsis.errors import ValueRangeError
from gsynopsis.pack import layout
from gsynopsis.pack.codecs import Bytes
from gsynopsis.records import LevelSet

FIELD = "manifest"


def write_manifest(levels: LevelSet, where: str) -> bytes:
    """The manifest of a level set; the same bytes for the same set.

    Raises:
        ValueRangeError: a figure is not finite, a name is not text, or it is too long.
    """
    quality = [level.quality for level in levels.levels]
    return manifest_text(levels.meta, quality, len(levels.levels), where)


def manifest_text(
    meta: Mapping[str, str], quality: Sequence[Mapping[str, float]], levels: int, where: str
) -> bytes:
    """The manifest as bytes, checked as a reader does.

    Raises:
        ValueRangeError: a figure is not finite, a name is not text, or it is too long.
    """
    figures = [{str(k): float(v) for k, v in level.items()} for level in quality]
    try:
        content = {"meta": dict(meta), "quality": figures}
        text = json.dumps(content, allow_nan=False, separators=(",", ":")).encode()
    except (TypeError, ValueError) as error:
        raise ValueRangeError(where, FIELD, found=error, expected="finite figures") from error
    if len(text) > layout.MANIFEST_BYTES_MAX:
        most = f"at most {layout.MANIFEST_BYTES_MAX}"
        raise ValueRangeError(where, FIELD, found=f"{len(text)} bytes", expected=most)
    read_manifest(text, levels, where)
    return text


def read_manifest(
    data: Bytes, levels: int, source: str
) -> tuple[dict[str, str], list[dict[str, float]]]:
    """Meta strings and the quality figures of each level.

    Raises:
        ValueRangeError: it is not the JSON it has to be.
    """
    try:
        content: Any = json.loads(
            bytes(data), object_pairs_hook=_unique, parse_constant=_no_constant
        )
    except (ValueError, RecursionError) as error:
        raise ValueRangeError(source, FIELD, found=error, expected="JSON") from error
    if not isinstance(content, dict):
        raise ValueRangeError(source, FIELD, found=type(content).__name__, expected="an object")
    entries = cast(dict[str, Any], content)
    if sorted(entries) != ["meta", "quality"]:
        raise ValueRangeError(source, FIELD, found=list(entries), expected="meta and quality")
    quality = _list_of(entries["quality"], levels, source)
    return _strings(entries["meta"], source), [_figures(figures, source) for figures in quality]


def _list_of(value: Any, count: int, source: str) -> Sequence[Any]:
    if isinstance(value, list) and len(cast(list[Any], value)) == count:
        return cast(list[Any], value)
    expected = f"a list of {count} objects"
    raise ValueRangeError(source, f"{FIELD}: quality", found=_short(value), expected=expected)


def _strings(value: Any, source: str) -> dict[str, str]:
    if isinstance(value, dict):
        entries = cast(dict[str, Any], value)
        if all(isinstance(text, str) for text in entries.values()):
            return entries
    raise ValueRangeError(source, f"{FIELD}: meta", found=_short(value), expected="names to text")


def _figures(value: Any, source: str) -> dict[str, float]:
    if isinstance(value, dict):
        entries = cast(dict[str, Any], value)
        if all(_is_figure(figure) for figure in entries.values()):
            return {name: float(figure) for name, figure in entries.items()}
    expected = "names to finite numbers"
    raise ValueRangeError(source, f"{FIELD}: quality", found=_short(value), expected=expected)


def _is_figure(value: Any) -> bool:
    if isinstance(value, int) and not isinstance(value, bool):
        return abs(value) < 1 << 1000
    return isinstance(value, float) and math.isfinite(value)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    entries = dict(pairs)
    if len(entries) != len(pairs):
        raise ValueError("a name stands twice")
    return entries


def _no_constant(name: str) -> NoReturn:
    raise ValueError(f"the constant {name}")


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
