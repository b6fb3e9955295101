"""The manifest chunk: what people want to know about a file, as checked JSON.

`{"meta": {name: text, …}, "quality": [{name: number, …}, …]}`, one quality object per level.
"""

import json
import math
from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any, NoReturn, cast

from gsynopsis.container import layout
from gsynopsis.container.codecs import Bytes
from gsynopsis.errors import ValueRangeError

FIELD = "manifest"


def manifest_text(
    meta: Mapping[str, str], quality: Sequence[Mapping[str, float]], levels: int, where: str
) -> bytes:
    """The manifest as bytes, checked as a reader does.

    Raises:
        ValueRangeError: a figure is not finite, a name is not text, or it is too long.
    """
    figures = [{str(k): float(v) for k, v in level.items()} for level in quality]
    try:
        notes = {
            _without_surrogates(name): _without_surrogates(text) for name, text in meta.items()
        }
        content = {"meta": notes, "quality": figures}
        text = json.dumps(content, allow_nan=False, separators=(",", ":")).encode()
    except (TypeError, ValueError) as error:
        raise ValueRangeError(where, FIELD, found=error, expected="finite figures") from error
    if len(text) > layout.MANIFEST_BYTES_MAX:
        most = f"at most {layout.MANIFEST_BYTES_MAX}"
        raise ValueRangeError(where, FIELD, found=f"{len(text)} bytes", expected=most)
    read_manifest(text, levels, where)
    return text


def _without_surrogates(text: object) -> object:
    """The same text with "?" for lone surrogates, as in names of files that are not UTF-8."""
    return text.encode(errors="replace").decode() if isinstance(text, str) else text


def read_manifest(
    data: Bytes, levels: int, source: str
) -> tuple[dict[str, str], list[dict[str, float]]]:
    """Meta strings and the quality figures of each level.

    Raises:
        ValueRangeError: it is not the JSON it has to be.
    """
    try:
        # Bytes would be taken for UTF-16 or UTF-32 where they look like it.
        text = bytes(data).decode("utf-8")
        content: Any = json.loads(text, object_pairs_hook=_unique, parse_constant=_no_constant)
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
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    entries = dict(pairs)
    for text in chain.from_iterable(pairs):
        if isinstance(text, str):
            text.encode()  # refuses half of a surrogate pair, which no UTF-8 can say
    if len(entries) != len(pairs):
        raise ValueError("a name stands twice")
    return entries


def _no_constant(name: str) -> NoReturn:
    raise ValueError(f"the constant {name}")


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
