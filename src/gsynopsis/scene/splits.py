"""Training and held-out views: by the lists of a scene's own files, else by a rule."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from gsynopsis.errors import SceneError

Split = Literal["every8", "validation", "bungee", "none"]
"""Rule that chooses the held-out views.

Every 8th by sorted name; of the others every 7th, without the 8ths (to choose settings by); the
first 31 by sorted name, as for BungeeNeRF (methods.md §3.1); or none: training views serve as test
views too.
"""
BUNGEE_TEST = 31
EVERY = 8
VALIDATION = 4
"""Index, in each eight views, of the one held out for validation; the first is a test view."""
CUT = re.compile(r"view\d+/(.+)", re.ASCII)
"""Names of views that were cut out of a panorama."""
Parts = tuple[tuple[int, ...], tuple[int, ...], tuple[str, ...]]
"""Training views, test views, both ascending, and notes."""


@dataclass(frozen=True)
class SplitLists:
    """Names of views as a scene's files list them; a view may be in several lists.

    Attributes:
        source: The files or fields that list them, for messages.
        train: To learn from; None: all that are not in another list.
        test: Held out.
        val: Held out to choose settings by, as the split `validation` does.
    """

    source: str
    train: frozenset[str] | None
    test: frozenset[str] = frozenset()
    val: frozenset[str] = frozenset()

    def divide(self, names: Sequence[str], usable: Sequence[int], split: Split) -> Parts:
        """The parts of views with these names, given the indices of usable ones.

        Photos for validation are held out if there are none for the test, or if that is the
        requested split. If the lists hold out none, photos in no list are held out.
        """
        held = self.val if split == "validation" and self.val else self.test or self.val
        listed = [i for i in usable if self.train is None or names[i] in self.train]
        if not held and self.train is not None:
            held = frozenset(names[i] for i in usable) - self.train
        test = tuple(i for i in usable if names[i] in held)
        out = self.test | self.val if self.train is None else frozenset[str]()
        train = tuple(i for i in listed if names[i] not in out | held) or tuple(listed)
        unused = len(set(usable) - {*train, *test})
        rest = f": {unused} photos of other lists or none are not used" if unused else ""
        return train, test or train, (f"split by {self.source}{rest}",)


def split_names(path: Path, names: Sequence[str], split: Split) -> Parts:
    """As `split_views`, of views with these names; those of one panorama stay together.

    Else a view would be held out while its neighbours, which overlap it, are trained on.

    Raises:
        SceneError: The split leaves no view to train on.
    """
    wholes = [found[1] if (found := CUT.fullmatch(name)) else name for name in names]
    photos = sorted(set(wholes))
    if len(photos) in (1, len(names)):
        return split_views(path, len(names), split)
    train, test, notes = split_views(path, len(photos), split)
    sides = [{photos[i] for i in side} for side in (train, test)]
    parts = [tuple(i for i, whole in enumerate(wholes) if whole in side) for side in sides]
    told = f"views of one panorama are held out together: {len(test)} of {len(photos)}"
    return parts[0], parts[1], (*notes, told)


def split_views(path: Path, count: int, split: Split) -> Parts:
    """Training views, test views and notes for `count` views sorted by name.

    Raises:
        SceneError: The split leaves no view to train on.
    """
    everything = tuple(range(count))
    if split == "none":
        return everything, everything, ("no view is held out: test views were trained on",)
    if split == "bungee":
        if count <= BUNGEE_TEST:
            wanted = f"more than {BUNGEE_TEST} images for the split 'bungee'"
            raise SceneError(path, "images", found=count, expected=wanted)
        return everything[BUNGEE_TEST:], everything[:BUNGEE_TEST], ()
    if split == "validation":
        held_out = tuple(i for i in everything if i % EVERY == VALIDATION)
        if not held_out:
            wanted = f"more than {VALIDATION} images for the split 'validation'"
            raise SceneError(path, "images", found=count, expected=wanted)
        train = tuple(i for i in everything if i % EVERY not in (0, VALIDATION))
        return train, held_out, ("held-out views are of the validation set, not of the test set",)
    return tuple(i for i in everything if i % EVERY), everything[::EVERY], ()
