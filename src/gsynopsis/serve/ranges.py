"""The Range header of RFC 9110 §14, read once and made plain."""

import re
from typing import Literal

PARTS_MAX = 16
"""Parts in one request; a header with more is ignored and gets the whole file."""
DIGITS_MAX = 18
"""Longer numbers lie beyond every file, and need not be turned into integers."""
PART = re.compile(r"([0-9]*)-([0-9]*)", re.ASCII)


def plain_range(
    header: str, size: int
) -> list[tuple[int, int]] | Literal["whole", "unsatisfiable"]:
    """What a Range header means for a file of `size` bytes.

    Args:
        header: The header's value.
        size: Bytes of the file, at least 0.

    Returns:
        The parts that lie within the file as `(start, stop)`, in the order of the file and joined
        where they overlap, so that no byte is sent twice; or "whole" where the header is to be
        ignored (another unit, a syntax error, too many parts); or "unsatisfiable" (416) where no
        part touches the file.
    """
    unit, equals, text = header.partition("=")
    if not equals or unit.strip().lower() != "bytes":
        return "whole"
    words = [word.strip() for word in text.split(",") if word.strip()]
    if not 0 < len(words) <= PARTS_MAX:
        return "whole"
    parts: list[tuple[int, int]] = []
    for word in words:
        match = PART.fullmatch(word)
        if match is None or word == "-":
            return "whole"
        first, last = (_number(digits) for digits in match.groups())
        if first is not None and last is not None and last < first:
            return "whole"
        if first is None:
            first, last = max(0, size - (last or 0)), size - 1
        last = size - 1 if last is None else min(last, size - 1)
        if first <= last:
            parts.append((first, last + 1))
    return _joined(parts) if parts else "unsatisfiable"


def _joined(parts: list[tuple[int, int]]) -> list[tuple[int, int]]:
    joined: list[tuple[int, int]] = []
    for start, stop in sorted(parts):
        if joined and start <= joined[-1][1]:
            joined[-1] = joined[-1][0], max(stop, joined[-1][1])
        else:
            joined.append((start, stop))
    return joined


def _number(digits: str) -> int | None:
    if not digits:
        return None
    digits = digits.lstrip("0") or "0"
    return int(digits) if len(digits) <= DIGITS_MAX else 10**DIGITS_MAX
