"""What the product makes of the test vectors: Gaussians of all levels, and images of two."""

import json
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from gsynopsis.container import decode
from gsynopsis.model.splats import decoder_of
from gsynopsis.records import LevelSet
from gsynopsis.render.base import Gaussians
from gsynopsis.render.reference import ReferenceRenderer
from gsynopsis.scene.camera import Camera

SIZE = (48, 32)
BACKGROUND = (0.1, 0.25, 0.4)
FAR, NEAR = (0.35, -0.4, -0.9), (1.9, -2.2, -3.6)
EYES = {
    "paper-sequential": NEAR,
    "values-joint": NEAR,
    "values-tied": (0.6, -0.4, 0.0),
    "splats-compact": (0.3137, -0.4311, -0.8613),
    "splats-raw": (0.3137, -0.4311, -0.8613),
}
"""Where a vector's camera stands: before the random sets, a metre wide, and before or in the
larger ones."""
TARGETS = {"values-tied": (-0.4, 0.5, 0.4)}
FIELDS = ("means", "quats", "scales", "opacities", "colors")
Arrays = dict[str, NDArray[np.generic]]


def camera_of(name: str) -> Camera:
    """A vector's camera: pixels are not square, the principal point is not the middle."""
    eye, target = (np.array(v) for v in (EYES.get(name, FAR), TARGETS.get(name, (0, 0.1, 0))))
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.1, -1.0, 0.05])
    right /= np.linalg.norm(right)
    w2c = np.eye(4)
    w2c[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    w2c[:3, 3] = -w2c[:3, :3] @ eye
    return Camera(*SIZE, fx=46.0, fy=43.5, cx=25.3, cy=14.6, w2c=w2c)


def gaussians_of(levels: LevelSet, number: int, camera: Camera) -> tuple[Gaussians, torch.Tensor]:
    """All Gaussians of a level for a camera's position, and their flat slots.

    Culling saves work and decides nothing: here all anchors are decoded.
    """
    model = decoder_of(levels)
    part = model.part(number)
    rows = part.mask.any(dim=1).nonzero()[:, 0]
    model.visible = lambda _part, _camera: rows  # type: ignore[method-assign]
    with torch.no_grad():
        decoded = model.decode_level(number, camera)
    return decoded.gaussians, decoded.slots


def drawing(levels: LevelSet, camera: Camera) -> Arrays:
    """The arrays of a vector's npz file, see docs/format.md."""
    arrays: Arrays = {}
    renderer, background = ReferenceRenderer(), torch.tensor(BACKGROUND)
    last = len(levels.levels) - 1
    for k in range(last + 1):
        gaussians, slots = gaussians_of(levels, k, camera)
        arrays |= {f"{name}_{k}": getattr(gaussians, name).numpy() for name in FIELDS}
        arrays[f"slots_{k}"] = slots.numpy().astype(np.int32)
        if k in (0, last):
            arrays[f"image_{k}"] = renderer.render(gaussians, camera, background).image.numpy()
    return arrays


def write_drawings(folder: Path, names: list[str]) -> None:
    """Write `cameras.json`, and an npz file beside each vector."""
    cameras: dict[str, dict[str, object]] = {}
    for name in names:
        c = camera_of(name)
        lens = {key: getattr(c, key) for key in ("width", "height", "fx", "fy", "cx", "cy")}
        w2c = c.w2c[:3].ravel().tolist()
        cameras[name] = {**lens, "w2c": w2c, "background": list(BACKGROUND)}
        arrays = drawing(decode((folder / f"{name}.gsyn").read_bytes(), name), c)
        np.savez_compressed(folder / f"{name}.npz", **arrays)  # type: ignore[arg-type]
    (folder / "cameras.json").write_text(json.dumps(cameras, indent=1) + "\n")
