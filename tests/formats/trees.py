"""A tree whose crown says which way is up, as files that other programs write."""

import gzip
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gsynopsis.formats.writers.forge import forge_bytes
from gsynopsis.formats.writers.glb import glb_bytes
from gsynopsis.formats.writers.packed import packed_bytes
from gsynopsis.formats.writers.ply import ply_bytes
from gsynopsis.formats.writers.sog import sog_bytes, zipped
from gsynopsis.formats.writers.ssog import ssog_files
from gsynopsis.formats.writers.usd import usd_bytes
from gsynopsis.jobs.export import Format
from gsynopsis.records import PlainGaussians

HEIGHT = 1.8
"""Of the crown above the lawn, which is at 0."""
Points = NDArray[np.float64]


def tree(up: tuple[float, float, float] = (0.0, -1.0, 0.0), count: int = 60) -> PlainGaussians:
    """A lawn with a red crown above one corner of it: no turn but the right one brings it back."""
    rng = np.random.default_rng(3)
    crown = np.arange(count) % 3 == 0
    flat = rng.uniform(-1.0, 1.0, (count, 2))
    flat[crown] = 0.6 + 0.05 * flat[crown]
    axis = np.array(up)
    side = np.cross(axis, [1.0, 0.0, 0.0])
    high = np.where(crown, HEIGHT, 0.0)[:, None]
    means = high * axis + flat[:, :1] * side + flat[:, 1:] * np.cross(axis, side)
    turn = np.zeros((count, 4))
    turn[:, 0] = 1
    sh = np.where(crown[:, None], [1.4, -1.2, -1.2], [-1.2, 1.0, -1.2])
    return PlainGaussians(
        means=means.astype(np.float32),
        log_scales=np.full((count, 3), -2.5, np.float32),
        quaternions=turn.astype(np.float32),
        logits=np.full(count, 3, np.float32),
        sh=sh[:, None].astype(np.float32),
    )


def crown_of(points: Points, sh: NDArray[Any]) -> Points:
    """Where the middle of the red splats is."""
    return points[sh[:, 0, 0] > sh[:, 0, 1]].mean(axis=0)


def write_tree(folder: Path, kind: str) -> Path:
    """The tree as a file of a kind that is read."""
    folder.mkdir(exist_ok=True)
    if kind == "ssog":
        for name, data in _streamed().items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_bytes(data)
        return folder / "lod-meta.json"
    written = {
        "ply": lambda: ply_bytes(tree()),
        "ply-z": lambda: commented(ply_bytes(tree((0, 0, 1))), "Vertical Axis: z"),
        "ply-oblique": lambda: commented(ply_bytes(tree((0, 0.6, 0.8))), "up_axis = 0,0.6,0.8"),
        "compressed-ply": lambda: packed_bytes(tree()),
        "spz2": lambda: spz_bytes(tree((0, 1, 0))),
        "spz4": lambda: forge_bytes(tree(), "spz"),
        "sog": lambda: sog_bytes(tree()),
        "ssog-zip": lambda: zipped(_streamed()),
        "splat": lambda: splat_bytes(tree()),
        "ksplat": lambda: ksplat_bytes(tree()),
        "glb": lambda: glb_bytes(tree()),
        "usd": lambda: usd_bytes(tree()),
    }
    path = folder / f"tree.{kind if kind in ('splat', 'ksplat') else 'bin'}"
    path.write_bytes(written[kind]())
    return path


def _streamed() -> dict[str, bytes]:
    return ssog_files([tree(count=30), tree()])


def commented(ply: bytes, comment: str) -> bytes:
    """A PLY with one more line in its header."""
    return ply.replace(b"element", b"comment " + comment.encode() + b"\nelement", 1)


def spz_bytes(g: PlainGaussians) -> bytes:
    """SPZ 2 of Gaussians of degree 0, values as they are."""
    fixed = np.rint(g.means * 4096).astype("<i4").reshape(-1).view(np.uint8).reshape(-1, 4)
    color = np.clip(np.rint((g.sh[:, 0] * 0.15 + 0.5) * 255), 0, 255).astype(np.uint8)
    parts = [
        struct.pack("<4sIIBBBB", b"NGSP", 2, len(g), 0, 12, 0, 0),
        fixed[:, :3].tobytes(),
        np.full(len(g), 242, np.uint8).tobytes(),
        color.tobytes(),
        np.rint((g.log_scales + 10) * 16).astype(np.uint8).tobytes(),
        np.full((len(g), 3), 128, np.uint8).tobytes(),
    ]
    return gzip.compress(b"".join(parts))


def ksplat_bytes(g: PlainGaussians) -> bytes:
    """One section of mkkellogg's viewer, nothing rounded but colours."""
    color = np.clip(np.rint((g.sh[:, 0] * 0.28209479177387814 + 0.5) * 255), 0, 255)
    rest = np.concatenate([color, np.full((len(g), 1), 242)], axis=1).astype(np.uint8)
    floats = np.concatenate([g.means, np.exp(g.log_scales), g.quaternions], axis=1).astype("<f4")
    head = struct.pack("<BBxxIIII", 0, 1, 1, 1, len(g), len(g)).ljust(4096, b"\0")
    section = struct.pack("<II", len(g), len(g)).ljust(1024, b"\0")
    rows = b"".join(a.tobytes() + b.tobytes() for a, b in zip(floats, rest, strict=True))
    return head + section + rows


def splat_bytes(g: PlainGaussians) -> bytes:
    """The rows of antimatter15's viewer."""
    color = np.clip(np.rint((g.sh[:, 0] * 0.28209479177387814 + 0.5) * 255), 0, 255)
    rest = np.concatenate([color, np.full((len(g), 1), 242), g.quaternions * 127 + 128], axis=1)
    floats = np.concatenate([g.means, np.exp(g.log_scales)], axis=1).astype("<f4")
    rows = zip(floats, rest.astype(np.uint8), strict=True)
    return b"".join(a.tobytes() + b.tobytes() for a, b in rows)


def shown_world(path: Path, name: Format) -> tuple[Points, NDArray[Any]]:
    """Positions in the world of a glTF or USD file, node turned, and coefficients [G, 1, 3]."""
    return _world_of_usd(path) if name == "usd" else _world_of_glb(path)


def _world_of_glb(path: Path) -> tuple[Points, NDArray[Any]]:
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    document = json.loads(data[20 : 20 + length])
    names = document["meshes"][0]["primitives"][0]["attributes"]

    def column(name: str) -> NDArray[Any]:
        view = document["bufferViews"][document["accessors"][names[name]]["bufferView"]]
        start = 28 + length + view["byteOffset"]
        values = np.frombuffer(data, "<f4", view["byteLength"] // 4, start)
        return values.reshape(-1, 3).astype(np.float64)

    x, y, z, w = document["nodes"][0].get("rotation", [0, 0, 0, 1])
    vector, points = np.array([x, y, z]), column("POSITION")
    across = 2 * np.cross(vector, points)
    color = column("KHR_gaussian_splatting:SH_DEGREE_0_COEF_0")
    return points + w * across + np.cross(vector, across), color[:, None]


def _world_of_usd(path: Path) -> tuple[Points, NDArray[Any]]:
    from importlib import import_module

    usd, geom, vol = (import_module(f"pxr.{name}") for name in ("Usd", "UsdGeom", "UsdVol"))
    stage = usd.Stage.Open(str(path))
    field = vol.ParticleField3DGaussianSplat(stage.GetDefaultPrim())
    matrix = np.array(geom.XformCache().GetLocalToWorldTransform(field.GetPrim()))
    points = np.array(field.GetPositionsAttr().Get(), np.float64)
    color = np.array(field.GetRadianceSphericalHarmonicsCoefficientsAttr().Get(), np.float64)
    return points @ matrix[:3, :3] + matrix[3, :3], color[:, None]
