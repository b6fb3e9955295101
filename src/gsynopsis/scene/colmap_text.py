"""COLMAP's text layout: cameras.txt, images.txt and points3D.txt.

COLMAP writes the number of records into a comment and ends every line. Where that comment is
there, the file must hold that many records and end with a line end, so that a truncated file is
refused; a file without the comment was made by hand and is taken as it is.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import SceneError
from gsynopsis.scene.colmap_layout import (
    Pinhole,
    Pose,
    SparseModel,
    Tracks,
    pinhole,
    pose,
    refuse_model,
)
from gsynopsis.scene.lenses import PARAMS

DECLARED = re.compile(r"^# Number of (?:cameras|images|points): (\d+)", re.MULTILINE)
LONGEST_COUNT = 18
"""Digits of a declared count."""
TRUNCATED = "the file is truncated or damaged: copy or export it again"
Number = TypeVar("Number", int, float)


class _Lines:
    """The data lines of a text file with their numbers, comments left out."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            text = path.read_bytes().decode("utf-8")
        except OSError as error:
            raise SceneError(path, found=error.strerror, expected="a readable file") from error
        except UnicodeDecodeError as error:
            found = f"a byte that is not UTF-8 at {error.start}"
            raise SceneError(path, found=found, expected="a text file") from error
        match = DECLARED.search(text)
        self.declared = None if match is None else self._declared(match[1])
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
        try:
            return [kind(word) for word in words]
        except ValueError as error:
            found = " ".join(words)[:60] or "nothing"
            raise self.bad(line, field, found, "numbers") from error

    def finish(self, field: str, count: int) -> None:
        if self.declared is None:
            return
        if count != self.declared:
            raise SceneError(
                self.path, field, found=count, expected=self.declared, advice=TRUNCATED
            )
        if not self.whole:
            found = "an unfinished last line"
            raise SceneError(self.path, "end", found=found, expected="a line end", advice=TRUNCATED)


def read_text(folder: Path) -> SparseModel:
    """The model in `folder`'s cameras.txt, images.txt and points3D.txt.

    Raises:
        SceneError: A file is unreadable, truncated or holds what cannot be.
    """
    cameras = _read_cameras(_Lines(folder / "cameras.txt"))
    images = _read_images(_Lines(folder / "images.txt"))
    points, colors = _read_points(_Lines(folder / "points3D.txt"))
    return SparseModel(cameras, images, points, colors)


def read_text_tracks(folder: Path) -> Tracks:
    """The tracks of points3D.txt.

    Raises:
        SceneError: It is unreadable, or holds what cannot be.
    """
    text = _Lines(folder / "points3D.txt")
    places, images = list[list[float]](), list[list[int]]()
    for line, content in text.lines:
        words = content.split()
        if words:
            places.append(text.numbers(line, "point xyz", float, words[1:4]))
            images.append(text.numbers(line, "track", int, words[8::2]))
    lengths = [len(own) for own in images]
    return Tracks(
        np.array(places).reshape(-1, 3),
        np.array([image for own in images for image in own], np.int64),
        np.repeat(np.arange(len(places)), lengths),
    )


def _read_cameras(text: _Lines) -> dict[int, Pinhole]:
    """Lines of: id, model, width, height, parameters."""
    cameras = dict[int, Pinhole]()
    for line, content in text.lines:
        if not content:
            continue
        words = content.split()
        if len(words) < 4:
            raise text.bad(line, "camera", f"{len(words)} words", "at least 4")
        (number,) = text.numbers(line, "camera id", int, words[:1])
        if words[1] not in PARAMS:
            raise refuse_model(text.path, number, words[1])
        width, height = text.numbers(line, f"camera {number} size", int, words[2:4])
        params = text.numbers(line, f"camera {number} parameters", float, words[4:])
        wanted = PARAMS[words[1]]
        if len(params) != wanted:
            raise text.bad(line, f"camera {number} parameters", len(params), wanted)
        cameras[number] = pinhole(text.path, number, words[1], (width, height), params)
    text.finish("cameras", len(cameras))
    return cameras


def _read_images(text: _Lines) -> tuple[Pose, ...]:
    """Pairs of lines: id, quaternion, translation, camera, name; then triples of x, y, point.

    There may be no triple at all, so that an empty line counts where a second line is due.
    """
    images, due = list[Pose](), False
    for line, content in text.lines:
        if due:
            due = False
            if len(content.split()) % 3:
                found = f"{len(content.split())} numbers"
                raise text.bad(line, f"image {images[-1].name} observations", found, "threes")
        elif content:
            images.append(_parse_image(text, line, content))
            due = True
    if due and text.declared is not None:
        line = text.lines[-1][0] + 1
        raise text.bad(line, "observations", "the end of the file", "a line")
    text.finish("images", len(images))
    return tuple(images)


def _parse_image(text: _Lines, line: int, content: str) -> Pose:
    words = content.split(maxsplit=9)
    if len(words) < 10:
        raise text.bad(line, "image", f"{len(words)} words", "10 (the last is the name)")
    numbers = text.numbers(line, f"image {words[9]} pose", float, words[1:8])
    (number,) = text.numbers(line, f"image {words[9]} id", int, words[:1])
    (camera,) = text.numbers(line, f"image {words[9]} camera", int, words[8:9])
    return replace(pose(text.path, words[9], camera, numbers), number=number)


def _read_points(text: _Lines) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Lines of: id, xyz, rgb, error, track of image and index."""
    places, colors = list[list[float]](), list[list[int]]()
    for line, content in text.lines:
        if not content:
            continue
        words = content.split()
        if len(words) < 8 or len(words) % 2:
            raise text.bad(line, "point", f"{len(words)} words", "8 and pairs of track elements")
        places.append(text.numbers(line, "point xyz", float, words[1:4]))
        color = text.numbers(line, "point rgb", int, words[4:7])
        if not all(0 <= value <= 255 for value in color):
            raise text.bad(line, "point rgb", color, "0 to 255")
        colors.append(color)
    text.finish("points", len(places))
    return np.array(places).reshape(-1, 3), np.array(colors, np.uint8).reshape(-1, 3)
