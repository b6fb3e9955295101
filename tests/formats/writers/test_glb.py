"""GLB as the specification of KHR_gaussian_splatting has it, read by hand."""

import json
import struct

import numpy as np
import pytest

from gsynopsis.formats.writers.glb import EXTENSION, glb_bytes
from tests.formats.scattered import scattered


def parsed(data: bytes) -> tuple[dict, bytes]:
    magic, version, length, size = struct.unpack("<4sIII", data[:16])
    assert (magic, version, length) == (b"glTF", 2, len(data))
    document = json.loads(data[20 : 20 + size])
    start = 20 + size
    assert struct.unpack("<I4s", data[start : start + 8])[1] == b"BIN\0"
    return document, data[start + 8 :]


def values(document: dict, binary: bytes, name: str) -> np.ndarray:
    primitive = document["meshes"][0]["primitives"][0]
    accessor = document["accessors"][primitive["attributes"][name]]
    view = document["bufferViews"][accessor["bufferView"]]
    piece = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
    return np.frombuffer(piece, "<f4").reshape(accessor["count"], -1)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_attributes_hold_values_after_activation(degree: int) -> None:
    g = scattered(degree=degree)
    document, binary = parsed(glb_bytes(g))
    assert np.array_equal(values(document, binary, "POSITION"), g.means)
    turns = values(document, binary, f"{EXTENSION}:ROTATION")
    assert np.allclose(np.linalg.norm(turns, axis=1), 1, atol=1e-6)
    assert np.allclose(turns[:, 3] * np.linalg.norm(g.quaternions, axis=1), g.quaternions[:, 0])
    opacities = values(document, binary, f"{EXTENSION}:OPACITY")[:, 0]
    assert np.allclose(np.log(opacities / (1 - opacities)), g.logits, atol=1e-3)
    assert np.allclose(np.log(values(document, binary, f"{EXTENSION}:SCALE")), g.log_scales)
    last = values(document, binary, f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{2 * degree}")
    assert np.array_equal(last, g.sh[:, -1])


def test_the_extension_says_what_its_specification_asks_for() -> None:
    document, _ = parsed(glb_bytes(scattered(5)))
    primitive = document["meshes"][0]["primitives"][0]
    assert document["extensionsUsed"] == [EXTENSION]
    assert primitive["mode"] == 0
    expected = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    assert primitive["extensions"][EXTENSION] == expected
    position = document["accessors"][primitive["attributes"]["POSITION"]]
    assert len(position["min"]) == len(position["max"]) == 3
