"""Binary glTF with the ratified extension KHR_gaussian_splatting, every value as float32."""

import json
import struct
from typing import Any

import numpy as np

from gsynopsis.formats.readers.glb import EXTENSION
from gsynopsis.records import Float32, PlainGaussians

FLOAT = 5126
VERTICES = 34962
"""glTF's target number of a buffer view of vertex attributes, which glTF-Validator asks for."""
TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
HALF_TURN = [1.0, 0.0, 0.0, 0.0]
"""Rotation x y z w of the node: our y points down and z ahead, that of glTF up and back."""
MAGIC, VERSION = 0x46546C67, 2
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942


def glb_bytes(gaussians: PlainGaussians) -> bytes:
    """A GLB file with one node, one mesh and one primitive of points.

    Args:
        gaussians: At least one: glTF has no accessors of length 0.
    """
    attributes = _attributes(gaussians)
    binary = b"".join(values.astype("<f4").tobytes() for values in attributes.values())
    text = json.dumps(_document(attributes, len(binary)), separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    length = 12 + 8 + len(text) + 8 + len(binary)
    return b"".join(
        [
            struct.pack("<III", MAGIC, VERSION, length),
            struct.pack("<II", len(text), JSON_CHUNK),
            text,
            struct.pack("<II", len(binary), BINARY_CHUNK),
            binary,
        ]
    )


def _attributes(gaussians: PlainGaussians) -> dict[str, Float32]:
    """Values after activation by the names of attributes, each [G] or [G, 3 or 4]."""
    turned = gaussians.quaternions / np.linalg.norm(gaussians.quaternions, axis=1, keepdims=True)
    found: dict[str, Float32] = {
        "POSITION": gaussians.means,
        f"{EXTENSION}:ROTATION": np.roll(turned, -1, axis=1).astype(np.float32),
        f"{EXTENSION}:SCALE": np.exp(gaussians.log_scales).astype(np.float32),
        f"{EXTENSION}:OPACITY": (1 / (1 + np.exp(-gaussians.logits))).astype(np.float32),
    }
    for degree in range(gaussians.degree + 1):
        for k in range(2 * degree + 1):
            name = f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{k}"
            found[name] = gaussians.sh[:, degree * degree + k]
    return found


def _document(attributes: dict[str, Float32], length: int) -> dict[str, Any]:
    accessors: list[dict[str, Any]] = []
    views: list[dict[str, int]] = []
    offset = 0
    for name, values in attributes.items():
        width = 1 if values.ndim == 1 else values.shape[1]
        accessor: dict[str, Any] = {
            "bufferView": len(views),
            "componentType": FLOAT,
            "count": len(values),
            "type": TYPES[width],
        }
        if name == "POSITION":
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        accessors.append(accessor)
        size = 4 * width * len(values)
        place = {"buffer": 0, "byteOffset": offset, "byteLength": size}
        views.append({**place, "target": VERTICES})
        offset += size
    extension = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    primitive = {
        "mode": 0,
        "attributes": {name: number for number, name in enumerate(attributes)},
        "extensions": {EXTENSION: extension},
    }
    return {
        "asset": {"version": "2.0", "generator": "gsynopsis"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "rotation": HALF_TURN}],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": length}],
        "bufferViews": views,
        "accessors": accessors,
    }
