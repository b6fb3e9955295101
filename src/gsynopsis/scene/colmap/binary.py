"""COLMAP's binary layout, read with every count checked before it is believed, and written.

All numbers are little-endian. cameras.bin: u64 count; each i32 id, i32 model, u64 width,
u64 height, f64 parameters. images.bin: u64 count; each i32 id, f64 quaternion (w, x, y, z),
f64 translation [3], i32 camera, NUL-terminated name, u64 observations of f64 x, f64 y, i64 point.
points3D.bin: u64 count; each u64 id, f64 xyz [3], u8 rgb [3], f64 error, u64 track length,
i32 image and i32 index for each track element.
"""

import mmap
import os
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gsynopsis.errors import SceneError
from gsynopsis.files import open_regular
from gsynopsis.scene.colmap.model import (
    KNOWN,
    MODEL_NAMES,
    NO_POINTS,
    NO_TRACKS,
    Pinhole,
    Points,
    Pose,
    SparseModel,
    Tracks,
    pinhole,
    pose,
    refuse_model,
)

COUNT = struct.Struct("<Q")
CAMERA = struct.Struct("<iiQQ")
IMAGE = struct.Struct("<i7di")
POINT = struct.Struct("<Q3d3BdQ")
OBSERVATION_BYTES = 24
TRACK_BYTES = 8
SMALLEST_CAMERA = CAMERA.size + 8 * min(KNOWN.values())
SMALLEST_IMAGE = IMAGE.size + 1 + COUNT.size


class _Cursor:
    """Walks through a file; a field that is not wholly there is an error that names it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with open_regular(path, SceneError, "a readable file") as file:
            # Mapped: what no field needs is never read, however long the file says it is.
            size = os.fstat(file.fileno()).st_size
            self.data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) if size else b""
        self.at = 0

    def need(self, size: int, field: str) -> None:
        left = len(self.data) - self.at
        if size > left:
            advice = "the file is truncated or damaged: copy or export it again"
            raise SceneError(
                self.path,
                f"{field} at byte {self.at}",
                found=f"{left} bytes",
                expected=f"at least {size}",
                advice=advice,
            )

    def take(self, layout: struct.Struct, field: str) -> tuple[Any, ...]:
        self.need(layout.size, field)
        values = layout.unpack_from(self.data, self.at)
        self.at += layout.size
        return values

    def count(self, field: str, smallest: int) -> int:
        """A count of records, accepted only if the file has room for that many of the smallest."""
        (count,) = self.take(COUNT, field)
        self.need(count * smallest, f"{count} {field}")
        return count

    def skip(self, size: int, field: str) -> None:
        self.need(size, field)
        self.at += size

    def text(self, field: str) -> str:
        end = self.data.find(b"\0", self.at)
        if end < 0:
            self.need(len(self.data) - self.at + 1, field)
        raw = self.data[self.at : end]
        self.at = end + 1
        try:
            return raw.decode("utf-8")
        except UnicodeDecodeError as error:
            raise SceneError(self.path, field, found=raw[:40], expected="UTF-8") from error

    def finish(self) -> None:
        left = len(self.data) - self.at
        if left:
            field = f"end of records at byte {self.at}"
            raise SceneError(
                self.path, field, found=f"{left} more bytes", expected="the end of the file"
            )


def read_binary(folder: Path, points: bool = True) -> SparseModel:
    """The model in `folder`'s cameras.bin, images.bin and points3D.bin; other files are ignored.

    Without points3D.bin, or where points are not asked for, it has none.

    Raises:
        SceneError: A file is unreadable, truncated, too long or holds what cannot be.
    """
    cameras = _read_cameras(folder / "cameras.bin")
    images, lost = _read_images(folder / "images.bin")
    path = folder / "points3D.bin"
    places, colors, tracks = (
        _read_points(path) if points and path.is_file() else (*NO_POINTS, NO_TRACKS)
    )
    return SparseModel(cameras, images, places, colors, lost, tracks=tracks)


def _read_cameras(path: Path) -> dict[int, Pinhole]:
    cursor, cameras = _Cursor(path), dict[int, Pinhole]()
    for _ in range(cursor.count("cameras", SMALLEST_CAMERA)):
        number, kind, width, height = cursor.take(CAMERA, "camera")
        name = _model_name(kind)
        if name not in KNOWN:
            raise refuse_model(path, number, name)
        layout = struct.Struct(f"<{KNOWN[name]}d")
        params = cursor.take(layout, f"camera {number} parameters")
        cameras[number] = pinhole(path, number, name, (width, height), params)
    cursor.finish()
    return cameras


def _model_name(number: int) -> str:
    return MODEL_NAMES[number] if 0 <= number < len(MODEL_NAMES) else f"number {number}"


def _read_images(path: Path) -> tuple[tuple[Pose, ...], tuple[str, ...]]:
    cursor, images, lost = _Cursor(path), list[Pose](), list[str]()
    for index in range(cursor.count("images", SMALLEST_IMAGE)):
        number, *numbers, camera = cursor.take(IMAGE, f"image {index}")
        name = cursor.text(f"image {index} name")
        observations = cursor.count(f"image {name} observations", OBSERVATION_BYTES)
        cursor.skip(observations * OBSERVATION_BYTES, f"image {name} observations")
        if posed := pose(path, name, camera, numbers):
            images.append(replace(posed, number=number))
        else:
            lost.append(name)
    cursor.finish()
    return tuple(images), tuple(lost)


def _read_points(path: Path) -> Points:
    cursor = _Cursor(path)
    count = cursor.count("points", POINT.size)
    places = np.empty((count, 3))
    colors = np.empty((count, 3), np.uint8)
    lengths, images = np.empty(count, np.int64), [np.zeros(0, np.int32)]
    for index in range(count):
        _, x, y, z, red, green, blue, _, track = cursor.take(POINT, "point")
        start = cursor.at
        cursor.skip(track * TRACK_BYTES, "track")
        images.append(np.frombuffer(cursor.data, "<i4", 2 * track, start)[::2].copy())
        places[index] = x, y, z
        colors[index] = red, green, blue
        lengths[index] = track
    cursor.finish()
    shown = np.concatenate(images).astype(np.int64)
    return places, colors, Tracks(shown, np.repeat(np.arange(count), lengths))


def write_binary(folder: Path, model: SparseModel) -> None:
    """Writes cameras.bin, images.bin and points3D.bin without observations and tracks."""
    folder.mkdir(parents=True, exist_ok=True)
    cameras = [COUNT.pack(len(model.cameras))]
    for number, c in sorted(model.cameras.items()):
        kind = MODEL_NAMES.index("PINHOLE")
        cameras.append(CAMERA.pack(number, kind, c.width, c.height))
        cameras.append(struct.pack("<4d", c.fx, c.fy, c.cx, c.cy))
    images = [COUNT.pack(len(model.images))]
    for number, image in enumerate(model.images, start=1):
        images.append(IMAGE.pack(number, *image.quaternion, *image.translation, image.camera))
        images.append(image.name.encode() + b"\0" + COUNT.pack(0))
    points = [COUNT.pack(len(model.points))]
    for number, (xyz, rgb) in enumerate(zip(model.points, model.colors, strict=True), start=1):
        points.append(POINT.pack(number, *xyz.tolist(), *rgb.tolist(), 0.0, 0))
    for name, parts in {"cameras": cameras, "images": images, "points3D": points}.items():
        (folder / f"{name}.bin").write_bytes(b"".join(parts))
