"""RealityCapture's and RealityScan's *Internal/External camera parameters* (CSV) → `Poses`.

Heading, pitch and roll, degrees, turn a camera that looks down with its upper side to +y, in a
world with z up; f is of 35 mm film, its longer side 36; px and py are shares of the longer side
from the centre; k1 to k4 are of r² to r⁸. The turn is checked by a tests' vector: a camera that was
exported as XMP too (Epic's forum, thread 710449).
"""

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import SceneError
from gsynopsis.files import read_regular
from gsynopsis.scene.camera import world_to_camera
from gsynopsis.scene.colmap.distortion import STRAIGHT, Lens
from gsynopsis.scene.colmap.model import LARGEST, Pinhole
from gsynopsis.scene.programs.posed_photos import (
    MOST_BYTES,
    PhotosByLabel,
    PosedPhoto,
    Poses,
)
from gsynopsis.scene.stored import read_header

FILM = 36.0
"""Longer side of 35 mm film, mm."""
WANTED = ("name", "x", "y", "alt", "heading", "pitch", "roll", "f")
NUMBERS = (*WANTED[1:], "px", "py", "k1", "k2", "k3", "k4", "t1", "t2")
ADVICE = "export registration as `Internal/External camera parameters`"


def read_realitycapture(path: Path, photographs: PhotosByLabel) -> Poses:
    """The cameras of an export; sizes are those of the photos in the scene's folder.

    Raises:
        SceneError: the file lacks a column, or a number in it cannot be.
    """
    rows = _rows(path)
    photos, tangential = list[PosedPhoto](), False
    for row in rows:
        name = row["name"]
        field = f"camera {name[:100]}"
        value = {k: _number(path, f"{field}: {k}", row[k]) for k in NUMBERS if k in row}
        place = np.array([value["x"], value["y"], value["alt"]])
        rotation = rotation_of(value["heading"], value["pitch"], value["roll"])
        found = photographs.find(name)
        camera = None
        if found is not None:
            camera = _pinhole(path, field, value, read_header(found).size)
            tangential |= bool(value.get("t1") or value.get("t2"))
        photos.append(PosedPhoto(name, camera, world_to_camera(rotation, place), field))
    notes = ("t1 and t2 of RealityCapture are taken as OpenCV's p1 and p2",) * tangential
    return Poses(path, tuple(photos), notes=notes)


def rotation_of(heading: float, pitch: float, roll: float) -> NDArray[np.float64]:
    """Camera to world, [3, 3], OpenCV axes, of angles in degrees."""
    (ch, cp, cr), (sh, sp, sr) = (f(np.radians([-heading, pitch, roll])) for f in (np.cos, np.sin))
    about_z = np.array([[ch, -sh, 0], [sh, ch, 0], [0, 0, 1]])
    about_x = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    about_y = np.array([[cr, 0, sr], [0, 1, 0], [-sr, 0, cr]])
    # The camera of no turn looks down: OpenGL's axes, which OpenCV's are turned to.
    return about_z @ about_x @ about_y @ np.diag([1.0, -1.0, -1.0])


def _rows(path: Path) -> list[dict[str, str]]:
    """Rows by lower-case column, of lines that begin with a name."""
    text = read_regular(path, MOST_BYTES, SceneError).decode("utf-8-sig", "replace")
    lines = [line for line in text.splitlines() if line.strip()]
    head = next((n for n, line in enumerate(lines) if "name" in line.lower()), None)
    if head is None:
        raise SceneError(path, found="no row of column names", expected="#name,…", advice=ADVICE)
    separator = ";" if lines[head].count(";") > lines[head].count(",") else ","
    columns = [name.strip().lstrip("#").strip().lower() for name in lines[head].split(separator)]
    columns = ["alt" if c == "z" else "heading" if c == "yaw" else c for c in columns]
    lacking = [name for name in WANTED if name not in columns]
    if lacking:
        found, wanted = f"no column {', '.join(lacking)}", f"{', '.join(WANTED)}"
        raise SceneError(path, found=found, expected=wanted, advice=ADVICE)
    rows = list[dict[str, str]]()
    try:
        table = list(csv.reader(lines[head + 1 :], delimiter=separator))
    except csv.Error as error:
        raise SceneError(path, found=str(error), expected="a table of cameras") from error
    for number, cells in enumerate(table, start=head + 2):
        if len(cells) < len(columns):
            wanted = f"{len(columns)} cells"
            raise SceneError(path, f"line {number}", found=len(cells), expected=wanted)
        rows.append(dict(zip(columns, (cell.strip() for cell in cells), strict=False)))
    if not rows:
        raise SceneError(path, found="no camera", expected="registered cameras")
    return rows


def _pinhole(path: Path, field: str, value: dict[str, float], size: tuple[int, int]) -> Pinhole:
    longer, (width, height) = max(size), size
    focal = value["f"] * longer / FILM
    if focal <= 0:
        raise SceneError(path, f"{field}: f", found=value["f"], expected="a positive number")
    radial = tuple(value.get(f"k{n}", 0.0) for n in range(1, 5))
    lens = Lens(radial=radial, tangential=(value.get("t1", 0.0), value.get("t2", 0.0)))
    cx = width / 2 + value.get("px", 0.0) * longer
    cy = height / 2 + value.get("py", 0.0) * longer
    return Pinhole(width, height, focal, focal, cx, cy, STRAIGHT if lens.straight else lens)


def _number(path: Path, field: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) < LARGEST:
        raise SceneError(path, field, found=text[:100], expected="a finite number")
    return value
