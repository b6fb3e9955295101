"""Account of a scene's folder: the files that are used, and those that are not."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import msgspec

from gsynopsis.errors import printable

ESTIMATED = "scene.json"
"""Report that `gsynopsis scene` writes into the folder of a scene that it made."""
NAMED = 3
"""Names of photos in a line, at most."""
LONGEST = 60
"""Characters of a name in a line."""
PHOTO_ENDINGS = frozenset(
    f".{ending}"
    for ending in (
        *("heic", "heif", "avif", "jxl", "tif", "tiff", "webp", "bmp", "gif", "jp2", "exr", "hdr"),
        *("dng", "cr2", "cr3", "nef", "arw", "raf", "orf", "rw2"),
    )
)
"""Photos that other programs can write as JPEG."""
HEIC = frozenset([".heic", ".heif"])
"""Photos of phones, for which no library of a permissive licence is at hand."""
VIDEO_ENDINGS = frozenset([".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mts", ".insv"])


@dataclass(frozen=True)
class Account:
    """Account of a scene's folder: the files that are used, and those that are not.

    Readers of scenes fill in their part; `load_scene` completes it.

    Attributes:
        photos: Photos in use, for training or held out.
        source: File of their poses, relative to the scene's folder.
        left_out: Names of photos that are not used, by reason ("without a pose").
        unread: Number of other files among the photos, by ending (".heic"), lower case.
        beside: Other models, pose files, split lists and folders that are not read, a phrase each
            with a remedy.
        split: The lists or the rule that chose the held-out photos.
        masks: The use of masks, "none" without masks.
    """

    photos: int = 0
    source: str = ""
    left_out: Mapping[str, tuple[str, ...]] = field(default_factory=dict[str, tuple[str, ...]])
    unread: Mapping[str, int] = field(default_factory=dict[str, int])
    beside: tuple[str, ...] = ()
    split: str = ""
    masks: str = "none"

    def without(self, reason: str, names: Sequence[str]) -> "Account":
        """The same with more photos left out for a reason; unchanged if there are none."""
        if not names:
            return self
        every = (*self.left_out.get(reason, ()), *names)
        return replace(self, left_out={**self.left_out, reason: every})

    def with_unread_models(self, *phrases: str) -> "Account":
        """The same with more that is not read."""
        return replace(self, beside=(*self.beside, *phrases))

    def joined(self, before: "Account") -> "Account":
        """The same with what was passed over when the scene was made."""
        joined = replace(
            self,
            unread=dict(Counter(self.unread) + Counter(before.unread)),
            beside=(*before.beside, *self.beside),
        )
        for reason, names in before.left_out.items():
            joined = joined.without(reason, names)
        return joined

    def text(self) -> str:
        """The account as one line, names cut."""
        there = self.photos + sum(len(names) for names in self.left_out.values())
        used = f"{self.photos} of {there} photos used" if there else "no photos used"
        parts = [f"{used}, poses of {self.source}" if self.source else used]
        parts += [f"{len(n)} {reason} ({listed(n)})" for reason, n in self.left_out.items()]
        parts += [*unread_text(self.unread), *self.beside]
        if self.split:
            parts.append(f"held out by {self.split}")
        parts.append(f"masks: {self.masks}")
        return printable("; ".join(parts))

    def document(self) -> dict[str, Any]:
        """The account as plain values, names whole: what `--json` prints."""
        return asdict(self)


def estimated_account(root: Path) -> Account:
    """The account of the estimation that made the scene in a folder; empty where none did."""
    path = root / ESTIMATED
    try:
        values = json.loads(path.read_bytes() if path.is_file() else b"{}")
        return msgspec.convert(values["account"], Account)
    except (OSError, ValueError, KeyError, TypeError, RecursionError, msgspec.ValidationError):
        return Account()


def listed(names: Sequence[str]) -> str:
    """The first names, and how many more there are."""
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return f"{', '.join(_cut(name) for name in names[:NAMED])}{more}"


def _cut(name: str) -> str:
    name = printable(name)
    return name if len(name) <= LONGEST else f"{name[: LONGEST - 1]}…"


def unread_text(endings: Mapping[str, int]) -> list[str]:
    """A phrase on files that are not read, by ending; none if there are no such files."""
    if not endings:
        return []
    counts = ", ".join(f"{n} {ending}" for ending, n in sorted(endings.items()))
    advice: list[str] = []
    if PHOTO_ENDINGS & endings.keys():
        heic = ", HEIC by heif-convert or on the phone itself" if HEIC & endings.keys() else ""
        advice.append(f"convert photos to JPEG or PNG{heic}")
    if VIDEO_ENDINGS & endings.keys():
        advice.append("give a video itself in place of the folder")
    what_to_do = f" ({', '.join(advice)})" if advice else ""
    return [f"not looked at: {counts}{what_to_do}"]
