"""Metashape's cameras.xml (File → Export → Cameras, Agisoft XML) → `Poses`.

After appendix *Camera models* of Agisoft's manual: frame and fisheye cameras, f, b1, cx, cy and b2
in pixels, cx and cy from the image's centre, k1 to k4 of r² to r⁸; its P1 and P2 are OpenCV's p2
and p1. A camera's transform is camera to chunk, row by row, x right, y down, z forward.
"""

import xml.etree.ElementTree as ElementTree
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gsynopsis.errors import SceneError
from gsynopsis.files import read_regular
from gsynopsis.scene.camera import world_to_camera
from gsynopsis.scene.colmap.distortion import STRAIGHT, Lens
from gsynopsis.scene.colmap.model import LARGEST, LARGEST_SIDE, Pinhole
from gsynopsis.scene.programs.posed_photos import PosedPhoto, Poses

MODELS = ("frame", "fisheye")
"""Values of a sensor's `type` that are read; `spherical` and `cylindrical` are panoramas."""
NAMES = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2")
MOST_BYTES = 1 << 25
"""Most bytes of the file: 30,000 cameras; in memory a tree of XML is thirty times that."""
SKEW = 0.5
"""Most pixels that b2 may move a place in the image and be left out without a word."""


@dataclass(frozen=True)
class _Sensor:
    model: str
    camera: Pinhole | None
    skew: float  # pixels at the image's edge


def read_metashape(path: Path) -> Poses:
    """The cameras of the chunk with most of them; those without a pose are not among them.

    Raises:
        SceneError: the file is not such XML, or a number in it cannot be.
    """
    chunks = _document(path).findall("chunk")
    posed = [
        [c for c in chunk.iter("camera") if c.find("transform") is not None] for chunk in chunks
    ]
    if not any(posed):
        raise SceneError(path, found="no camera with a pose", expected="aligned cameras")
    best = max(range(len(chunks)), key=lambda number: len(posed[number]))
    beside = [_chunk_text(chunks[k], len(posed[k])) for k in range(len(chunks)) if k != best]
    parts = Counter(camera.get("component_id") for camera in posed[best])
    (part, _), *others = parts.most_common()
    if others:
        count = sum(n for _, n in others)
        beside.append(f"{count} cameras of {len(others)} other components are not read")
    sensors = {s.get("id"): _sensor(path, s) for s in chunks[best].iter("sensor")}
    photos, unknown, skewed = list[PosedPhoto](), list[tuple[str, str]](), 0.0
    for camera in posed[best]:
        label, sensor = camera.get("label") or "", sensors.get(camera.get("sensor_id"))
        if camera.get("component_id") != part:
            continue
        if sensor is None or sensor.camera is None:
            unknown.append((label, sensor.model if sensor else "none"))
            continue
        skewed = max(skewed, sensor.skew)
        field = f"camera {label}"
        matrix = _numbers(path, f"{field}: transform", camera.findtext("transform"), 16)
        c2w = np.array(matrix).reshape(4, 4)
        w2c = world_to_camera(c2w[:3, :3], c2w[:3, 3])
        photos.append(PosedPhoto(label, sensor.camera, w2c, field))
    notes = ("poses are in the units of Metashape's chunk, before its own transform",)
    if skewed > SKEW:
        notes += (f"b2 of Metashape is left out: places are off by up to {skewed:.1f} pixels",)
    return Poses(path, tuple(photos), notes=notes, beside=tuple(beside), unknown=tuple(unknown))


def _document(path: Path) -> ElementTree.Element:
    data = read_regular(path, MOST_BYTES, SceneError)
    try:
        return ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise SceneError(path, found=str(error)[:100], expected="Metashape's XML") from error


def _chunk_text(chunk: ElementTree.Element, count: int) -> str:
    name = (chunk.get("label") or "without a label")[:100]
    return f"chunk {name!r} of Metashape with {count} cameras is not read"


def _sensor(path: Path, sensor: ElementTree.Element) -> _Sensor:
    """A sensor's adjusted calibration, else its first one; no camera where it cannot be read."""
    model = sensor.get("type") or "frame"
    found = sensor.findall("calibration")
    adjusted = [c for c in found if c.get("class") == "adjusted"]
    calibration = (adjusted or found or [None])[0]
    if model not in MODELS or calibration is None:
        return _Sensor(model if model not in MODELS else f"{model} without calibration", None, 0.0)
    field = f"sensor {sensor.get('id')}"
    resolution = calibration.find("resolution")
    if resolution is None:
        resolution = sensor.find("resolution")
    sides = {} if resolution is None else resolution.attrib
    size = [sides.get("width", ""), sides.get("height", "")]
    if not all(side.isdecimal() and 1 <= int(side) <= LARGEST_SIDE for side in size):
        raise SceneError(path, f"{field}: resolution", found=size, expected="whole pixels")
    width, height = map(int, size)
    value = {n: _number(path, f"{field}: {n}", calibration.findtext(n)) for n in NAMES}
    if value["f"] <= 0:
        raise SceneError(path, f"{field}: f", found=value["f"], expected="a positive number")
    radial = tuple(value[f"k{n}"] for n in range(1, 5))
    lens = Lens(model == "fisheye", radial, tangential=(value["p2"], value["p1"]))
    camera = Pinhole(
        width,
        height,
        value["f"] + value["b1"],
        value["f"],
        width / 2 + value["cx"],
        height / 2 + value["cy"],
        STRAIGHT if lens.straight else lens,
    )
    return _Sensor(model, camera, abs(value["b2"]) * height / 2 / value["f"])


def _number(path: Path, field: str, text: str | None) -> float:
    return 0.0 if text is None else _numbers(path, field, text, 1)[0]


def _numbers(path: Path, field: str, text: str | None, count: int) -> list[float]:
    try:
        values = [float(word) for word in (text or "").split()]
    except ValueError:
        values = []
    if len(values) != count or not all(abs(value) < LARGEST for value in values):
        wanted = "a finite number" if count == 1 else f"{count} finite numbers"
        raise SceneError(path, field, found=repr(text)[:100], expected=wanted)
    return values
