"""Binary glTF with KHR_gaussian_splatting: y up, values after activation, nodes that turn them."""

import struct
from dataclasses import replace
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import InputError
from gsynopsis.files import open_regular
from gsynopsis.formats.axes import UP, matrix_of, quaternion_of, turned
from gsynopsis.formats.readers.base import (
    SplatFile,
    check_count,
    check_ratio,
    check_room,
    cleaned,
    joined,
    logits_of,
    shown,
)
from gsynopsis.formats.readers.opening import parsed
from gsynopsis.formats.readers.sog import FOREIGN
from gsynopsis.records import SH_0, Float32, PlainGaussians

MAGIC = b"glTF"
EXTENSION = "KHR_gaussian_splatting"
HEAD = struct.Struct("<4sIIII")
"""Magic, version, bytes, bytes of the JSON, its kind."""
JSON_MAX = 1 << 24
NODES_MAX = 10_000
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
TYPES = {5120: "i1", 5121: "u1", 5122: "i2", 5123: "u2", 5126: "f4"}
"""Types of components by glTF's number; integers are shares of their largest value."""
EVEN = 1e-3
"""By so much, relatively, scales along a node's axes may differ: splats have no shear."""
Float64 = NDArray[np.float64]


def read_glb(path: Path) -> SplatFile:
    """The Gaussians of all nodes of a GLB file's scene.

    Raises:
        InputError: it is damaged, has no Gaussians, or they are compressed or elsewhere.
    """
    with open_regular(path) as file:
        head = file.read(HEAD.size)
        check_room(len(head), HEAD.size, path, "header")
        _, version, _, length, _ = HEAD.unpack(head)
        if version != 2 or length > JSON_MAX:
            found = f"version {version}, {length:,} bytes of JSON"
            raise InputError(path, "header", found=found, expected=f"2, at most {JSON_MAX:,}")
        document = parsed(file.read(length).rstrip(b" \0"), path)
        with mmap(file.fileno(), 0, access=ACCESS_READ) as data:
            try:
                gaussians = _Document(document, data, HEAD.size + length + 8, path).gaussians()
            except FOREIGN as error:
                found = shown(f"{type(error).__name__}: {error}")
                raise InputError(path, found=found, expected=f"glTF with {EXTENSION}") from error
    return cleaned(SplatFile((gaussians,), up=UP, kind="GLB"), path)


class _Document:
    """A glTF document and the bytes of its buffer."""

    def __init__(self, document: dict[str, Any], data: mmap, start: int, path: Path) -> None:
        self.document, self.data, self.start, self.path = document, data, start, path

    def gaussians(self) -> PlainGaussians:
        """Those of all nodes of the scene, in the world."""
        document = self.document
        roots = document["scenes"][document.get("scene", 0)]["nodes"]
        nodes: list[tuple[int, Float64]] = [(number, np.eye(4)) for number in roots]
        placed: list[tuple[dict[str, Any], Float64]] = []
        for seen in range(NODES_MAX + 1):
            if not nodes:
                break
            if seen == NODES_MAX:
                raise ValueError(f"more than {NODES_MAX:,} nodes")
            number, above = nodes.pop()
            node = document["nodes"][number]
            world = above @ _matrix_of(node)
            nodes += [(child, world) for child in node.get("children", ())]
            if "mesh" in node:
                primitives = document["meshes"][node["mesh"]]["primitives"]
                placed += [(p, world) for p in primitives if EXTENSION in p.get("extensions", {})]
        total = sum(self._count(primitive) for primitive, _ in placed)
        check_count(total, self.path)
        check_ratio(total, len(self.data), self.path)
        return joined([moved_by(self._primitive(p), world) for p, world in placed])

    def _count(self, primitive: dict[str, Any]) -> int:
        count = self.document["accessors"][primitive["attributes"]["POSITION"]]["count"]
        if type(count) is not int or count < 0:
            raise ValueError(f"a count of {count}")
        return count

    def _primitive(self, primitive: dict[str, Any]) -> PlainGaussians:
        inner = primitive["extensions"][EXTENSION].get("extensions", {})
        if inner:
            found = f"splats compressed by {shown(next(iter(inner)))}"
            raise InputError(self.path, found=found, expected="splats as they are")
        names: dict[str, int] = primitive["attributes"]
        count = self._count(primitive)

        def column(name: str, width: int) -> Float32:
            return self._accessor(names[name], count, width)

        turn = column(f"{EXTENSION}:ROTATION", 4)
        with np.errstate(all="ignore"):
            return PlainGaussians(
                means=column("POSITION", 3),
                log_scales=np.log(column(f"{EXTENSION}:SCALE", 3)),
                quaternions=np.roll(turn, 1, axis=1),
                logits=logits_of(column(f"{EXTENSION}:OPACITY", 1)[:, 0].astype(np.float64)),
                sh=self._harmonics(names, count),
            )

    def _harmonics(self, names: dict[str, int], count: int) -> Float32:
        found: list[Float32] = []
        for degree in range(4):
            wanted = [f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{k}" for k in range(2 * degree + 1)]
            if not set(wanted) <= names.keys():
                break
            found += [self._accessor(names[name], count, 3) for name in wanted]
        if not found:
            color = self._accessor(names["COLOR_0"], count, None)[:, :3]
            found = [((color - 0.5) / SH_0).astype(np.float32)]
        return np.stack(found, axis=1)

    def _accessor(self, number: int, count: int, width: int | None) -> Float32:
        """Values of an attribute [count, width]."""
        accessor = self.document["accessors"][number]
        view = self.document["bufferViews"][accessor["bufferView"]]
        own = WIDTHS[accessor["type"]]
        if "sparse" in accessor or accessor["count"] != count or width not in (own, None):
            raise ValueError(f"accessor {number} with other values than it should have")
        if view["buffer"] or "uri" in self.document["buffers"][0]:
            raise ValueError("a buffer outside of the file")
        kind = np.dtype("<" + TYPES[accessor["componentType"]])
        places = (view.get("byteOffset", 0), accessor.get("byteOffset", 0))
        stride = view.get("byteStride", own * kind.itemsize)
        if not all(type(v) is int and v >= 0 for v in (*places, stride)):
            raise ValueError(f"places {shown(places)}, stride {shown(stride)}")
        start = self.start + sum(places)
        end = start + stride * (count - 1) + own * kind.itemsize
        check_room(len(self.data), end, self.path, f"accessor {number}")
        shape, strides = (count, own), (stride, kind.itemsize)
        values = np.array(np.ndarray(shape, kind, self.data, start, strides), np.float32)
        return values if kind.kind == "f" else values / np.float32(np.iinfo(kind).max)


def _matrix_of(node: dict[str, Any]) -> Float64:
    """Matrix of a node, to its parent's space [4, 4]."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    turn = np.array(node.get("rotation", [0, 0, 0, 1]), np.float64).reshape(4)
    found = np.eye(4)
    found[:3, :3] = matrix_of(np.roll(turn, 1)) * np.array(node.get("scale", [1, 1, 1]), np.float64)
    found[:3, 3] = node.get("translation", [0, 0, 0])
    return found


def moved_by(gaussians: PlainGaussians, world: Float64) -> PlainGaussians:
    """Gaussians of a node in the world, float64 [4, 4] from the node's space.

    Raises:
        ValueError: the node mirrors or scales them unevenly.
    """
    sizes = np.linalg.norm(world[:3, :3], axis=0)
    size = float(sizes.mean())
    if not np.isfinite(world).all() or not size > 0 or np.ptp(sizes) > EVEN * size:
        raise ValueError("a node that scales unevenly")
    turn = world[:3, :3] / size
    if np.linalg.det(turn) < 0:
        raise ValueError("a node that mirrors")
    found = turned(gaussians, quaternion_of(turn))
    return replace(
        found,
        means=(found.means * size + world[:3, 3]).astype(np.float32),
        log_scales=(found.log_scales + np.log(size)).astype(np.float32),
    )
