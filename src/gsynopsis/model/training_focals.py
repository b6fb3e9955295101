"""The note in a file on how large the photos were that each level was trained on (ours).

Without it a renderer cannot know how much of a Gaussian's size on the screen is its own and how
much the blur of the pixels of training (`render.base.low_pass_filter`).
"""

import json
from collections.abc import Sequence

from gsynopsis.model.view_bounds import finite_numbers
from gsynopsis.render.base import TrainingFocals


def focals_text(levels: Sequence[TrainingFocals]) -> str:
    """The note: JSON, for each level the shortest and longest focal length, pixels."""
    return json.dumps([list(focals) for focals in levels], separators=(",", ":"))


def parse_focals(text: str | None, levels: int) -> list[TrainingFocals] | None:
    """Focal lengths of each level from a note; None without a valid note."""
    try:
        values = json.loads(text or "")
        focals = [_checked(pair) for pair in values]
    except (ValueError, TypeError, OverflowError, RecursionError):
        return None
    return focals[:levels] if len(focals) >= levels else None


def _checked(pair: Sequence[object]) -> TrainingFocals:
    low, high = finite_numbers(pair)
    if not 0 < low <= high:
        raise ValueError
    return low, high
