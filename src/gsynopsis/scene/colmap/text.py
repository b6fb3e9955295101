"""COLMAP's text layout: cameras.txt, images.txt and points3D.txt.

COLMAP writes the number of records into a comment and ends every line. With that comment, the file
must hold at least this number of records and end with a line end, so that a truncated file is
refused; a file without the comment was made by hand and is taken as it is.

Other programs write this layout too: with a byte order mark or in UTF-16, without the second lines
of images.txt, with decimal commas, or with integers as `96.0`. These are read.
"""

import codecs
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from gsynopsis.errors import SceneError
from gsynopsis.files import open_regular
from gsynopsis.scene.colmap.model import (
    KNOWN,
    NO_POINTS,
    NO_TRACKS,
    QUATERNION_TOLERANCE,
    Pinhole,
    Points,
    Pose,
    SparseModel,
    Tracks,
    pinhole,
    pose,
    refuse_model,
)

DECLARED = re.compile(r"^# Number of (?:cameras|images|points): (\d+)", re.MULTILINE)
OBSERVATIONS = re.compile(r"[-+\d.,eE\s]*")
UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
HEAD = 1 << 16
"""Bytes that show whether a file is text, before the rest of it is read."""
LONGEST_COUNT = 18
"""Digits of a declared count."""
TRUNCATED = "the file is truncated or damaged: copy or export it again"
COUNTED = f"{TRUNCATED}; if nothing is missing, end the last line, or take out the comment"
NOT_A_NUMBER = re.compile(r"[-+]?(nan(\(.*\))?|1[.,]#(IND|INF|QNAN|SNAN)\w*)", re.IGNORECASE)
Number = TypeVar("Number", int, float)


class _Lines:
    """The data lines of a text file with their numbers, comments left out."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with open_regular(path, SceneError, "a readable file") as file:
            head = file.read(HEAD)
            if b"\0" in head and not head.startswith(UTF_16):
                raise SceneError(path, found="zero bytes", expected="a text file")
            raw = head + file.read()
        try:
            text = _decoded(raw)
        except UnicodeDecodeError as error:
            found = f"a byte that is not UTF-8 at {error.start}"
            raise SceneError(path, found=found, expected="a text file") from error
        match = DECLARED.search(text)
        self.declared = None if match is None else self._declared(match[1])
        self.notes: list[str] = []
        self.commas = False
        self.whole = text.endswith("\n")
        lines = (line.strip() for line in text.split("\n"))
        # The last piece is what follows the last line end: nothing, in a whole file.
        numbered = list(enumerate(lines, start=1))
        self.lines = [pair for pair in numbered if not pair[1].startswith("#")]
        if self.whole:
            self.lines.pop()

    def _declared(self, digits: str) -> int:
        if len(digits) > LONGEST_COUNT:
            found, wanted = f"{len(digits)} digits", f"at most {LONGEST_COUNT}"
            raise SceneError(self.path, "count", found=found, expected=wanted, advice=TRUNCATED)
        return int(digits)

    def bad(self, line: int, field: str, found: object, expected: object) -> SceneError:
        return SceneError(
            self.path, f"line {line}: {field}", found=found, expected=expected, advice=TRUNCATED
        )

    def numbers(
        self, line: int, field: str, kind: Callable[[str], Number], words: Sequence[str]
    ) -> list[Number]:
        if not self.commas and any("," in word for word in words):
            self.commas = True
            self.notes.append(f"{self.path.name} has decimal commas, read as points")
        try:
            return [kind(word) for word in words]
        except ValueError as error:
            found = " ".join(words)[:60] or "nothing"
            raise self.bad(line, field, found, "numbers") from error

    def finish(self, field: str, count: int) -> None:
        if self.declared is None:
            return
        if count < self.declared:
            raise SceneError(self.path, field, found=count, expected=self.declared, advice=COUNTED)
        if not self.whole:
            found = "an unfinished last line"
            raise SceneError(self.path, "end", found=found, expected="a line end", advice=COUNTED)
        if count > self.declared:
            self.notes.append(
                f"{self.path.name} has {count} {field}, its comment says {self.declared}: all read"
            )


def _decoded(raw: bytes) -> str:
    """UTF-8, or UTF-16 where a byte order mark says so, as PowerShell writes."""
    return raw.decode("utf-16" if raw.startswith(UTF_16) else "utf-8-sig")


def _real(word: str) -> float:
    """A number; a comma counts as the point, and Windows' words for NaN as NaN."""
    if NOT_A_NUMBER.fullmatch(word):
        return math.nan
    return float(word.replace(",", "."))


def _whole(word: str) -> int:
    """A whole number, `96.0` too."""
    try:
        return int(word)
    except ValueError:
        value = _real(word)
        if not value.is_integer():
            raise
        return int(value)


def read_text(folder: Path, points: bool = True) -> SparseModel:
    """The model in `folder`'s cameras.txt, images.txt and points3D.txt.

    Without points3D.txt, or where points are not asked for, it has none.

    Raises:
        SceneError: A file is unreadable, truncated or holds what cannot be.
    """
    texts = [_Lines(folder / "cameras.txt"), _Lines(folder / "images.txt")]
    cameras = _read_cameras(texts[0])
    images, lost = _read_images(texts[1])
    places, colors, tracks = *NO_POINTS, NO_TRACKS
    if points and (folder / "points3D.txt").is_file():
        texts.append(_Lines(folder / "points3D.txt"))
        places, colors, tracks = _read_points(texts[2])
    notes = tuple(note for text in texts for note in text.notes)
    return SparseModel(cameras, images, places, colors, lost, notes, tracks)


def _read_cameras(text: _Lines) -> dict[int, Pinhole]:
    """Lines of: id, model, width, height, parameters."""
    cameras = dict[int, Pinhole]()
    for line, content in text.lines:
        if not content:
            continue
        words = content.split()
        if len(words) < 4:
            raise text.bad(line, "camera", f"{len(words)} words", "at least 4")
        (number,) = text.numbers(line, "camera id", _whole, words[:1])
        if words[1] not in KNOWN:
            raise refuse_model(text.path, number, words[1])
        width, height = text.numbers(line, f"camera {number} size", _whole, words[2:4])
        params = text.numbers(line, f"camera {number} parameters", _real, words[4:])
        wanted = KNOWN[words[1]]
        if len(params) != wanted:
            raise text.bad(line, f"camera {number} parameters", len(params), wanted)
        cameras[number] = pinhole(text.path, number, words[1], (width, height), params)
    text.finish("cameras", len(cameras))
    return cameras


def _read_images(text: _Lines) -> tuple[tuple[Pose, ...], tuple[str, ...]]:
    """Pairs of lines: id, quaternion, translation, camera, name; then triples of x, y, point.

    There may be no triple at all, so that an empty line counts where a second line is due. Other
    programs leave second lines out. Images without a finite pose are given by name.
    """
    images, due, seconds = list[tuple[str, Pose | None]](), False, 0
    for line, content in text.lines:
        if due and not (content and _is_image(content)):
            due, seconds = False, seconds + 1
            if len(content.split()) % 3:
                found = f"{len(content.split())} numbers"
                raise text.bad(line, f"image {images[-1][0]} observations", found, "threes")
        elif content:
            images.append(_parse_image(text, line, content))
            due = True
    if due and seconds and text.declared is not None:
        line = text.lines[-1][0] + 1
        raise text.bad(line, "observations", "the end of the file", "a line")
    text.finish("images", len(images))
    lost = tuple(name for name, posed in images if posed is None)
    return tuple(posed for _, posed in images if posed), lost


def _parse_image(text: _Lines, line: int, content: str) -> tuple[str, Pose | None]:
    words = content.split(maxsplit=9)
    if len(words) < 10:
        raise text.bad(line, "image", f"{len(words)} words", "10 (the last is the name)")
    numbers = text.numbers(line, f"image {words[9]} pose", _real, words[1:8])
    (camera,) = text.numbers(line, f"image {words[9]} camera", _whole, words[8:9])
    (number,) = text.numbers(line, f"image {words[9]} id", _whole, words[:1])
    posed = pose(text.path, words[9], camera, numbers)
    return words[9], posed and replace(posed, number=number)


def _is_image(content: str) -> bool:
    """True for a line that begins an image although the second line of the one before is due.

    Observations are triples of numbers. If all words are numbers, a line is an image if its
    rotation is a unit quaternion, which observations in pixels are not.
    """
    words = content.split()
    try:
        numbers = [_real(word) for word in words[:9]]
    except ValueError:
        return False
    if len(words) < 10 or not all(numbers[k].is_integer() for k in (0, 8)):
        return False
    if len(words) % 3 or not OBSERVATIONS.fullmatch(content):
        return True
    return abs(math.hypot(*numbers[1:5]) - 1) <= QUATERNION_TOLERANCE


def _read_points(text: _Lines) -> Points:
    """Lines of: id, xyz, rgb, error, track of image and index."""
    places, colors, images = list[list[float]](), list[list[int]](), list[list[int]]()
    for line, content in text.lines:
        if not content:
            continue
        words = content.split()
        if len(words) < 8 or len(words) % 2:
            raise text.bad(line, "point", f"{len(words)} words", "8 and pairs of track elements")
        places.append(text.numbers(line, "point xyz", _real, words[1:4]))
        color = text.numbers(line, "point rgb", _whole, words[4:7])
        if not all(0 <= value <= 255 for value in color):
            raise text.bad(line, "point rgb", color, "0 to 255")
        colors.append(color)
        images.append(text.numbers(line, "track", _whole, words[8::2]))
    text.finish("points", len(places))
    rows = np.repeat(np.arange(len(places)), [len(own) for own in images])
    tracks = Tracks(np.array([image for own in images for image in own], np.int64), rows)
    return np.array(places).reshape(-1, 3), np.array(colors, np.uint8).reshape(-1, 3), tracks
