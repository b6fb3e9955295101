"""A scene folder of renders: what photos are to a training, made of a finished splat.

`transforms.json` is written last, so a folder that has it is whole. PNGs that a stopped process
left are not rendered again.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from gsynopsis.evaluation.metrics import to_bytes
from gsynopsis.files import publish, published
from gsynopsis.formats.axes import Up
from gsynopsis.model.splats import SplatModel
from gsynopsis.render.base import Renderer
from gsynopsis.scene.camera import STILL, Camera, Shift
from gsynopsis.scene.photos import load_photo
from gsynopsis.scene.ply import ply_bytes
from gsynopsis.scene.scene import Scene
from gsynopsis.scene.transforms import NOTE, UP
from gsynopsis.scene.views import View

IMAGES, ALPHA, POINTS, TRANSFORMS = "images", "alpha", "points.ply", "transforms.json"
LISTS = {
    "train": "train_filenames",
    "photos": "train_filenames",
    "test": "test_filenames",
    "val": "val_filenames",
}
"""Fields of nerfstudio for the views of each part."""
LEVEL = 3
"""Level of PNG's compression: a higher one takes longer than a render."""
Views = Mapping[str, Sequence[Camera]]
"""Cameras of the parts `train`, `photos`, `test` and `val`."""
Photos = Mapping[str, Callable[[int, NDArray[np.uint8]], NDArray[np.uint8]]]
"""Parts that are photos: gives the pixels of one by its number and the render of its camera."""
Tick = Callable[[str, int, int], None]
"""Told what is done, how much of it, and of how much."""


def write_renders(
    model: SplatModel, views: Views, photos: Photos, folder: Path, renderer: Renderer, tick: Tick
) -> None:
    """Render all views of a model on black into `images/`, their opacity into `alpha/`.

    Views that nothing is trained on have no alpha; photos are opaque.

    Args:
        model: The splats; its finest level is rendered.
        views: Cameras.
        photos: Parts that are photos.
        folder: Of the scene.
        renderer: Of the model's device.
        tick: Told of progress.

    Raises:
        SceneError: a photo cannot be decoded.
        SpaceError: the disk is full.
    """
    black = torch.zeros(3, device=renderer.device)
    total, done = sum(map(len, views.values())), 0
    for part, cameras in views.items():
        for number, camera in enumerate(cameras):
            kinds = (IMAGES, ALPHA) if LISTS[part] == LISTS["train"] else (IMAGES,)
            paths = {kind: folder / kind / name_of(part, number) for kind in kinds}
            missing = {kind: path for kind, path in paths.items() if not path.exists()}
            if missing:
                with torch.no_grad():
                    found = renderer.render(model.decode(camera, -1), camera, black)
                image, alpha = to_bytes(found.image), to_bytes(found.alpha)
                if part in photos:
                    image, alpha = photos[part](number, image), np.full_like(alpha, 255)
                for kind, path in missing.items():
                    _save(image if kind == IMAGES else alpha, path)
            done += 1
            tick("rendering the input", done, total)


def _save(pixels: NDArray[np.uint8], path: Path) -> None:
    with published(path) as draft:
        Image.fromarray(pixels).save(draft, "PNG", compress_level=LEVEL)


class RenderedAlpha:
    """Opacity of renders, from `alpha/` of a scene of renders."""

    def __init__(self, scene: Scene) -> None:
        """Files are read when they are asked for and kept: a byte a pixel."""
        self._scene = scene
        self._held: dict[int, NDArray[np.uint8]] = {}

    def __call__(self, view: int, factor: float, shift: Shift) -> torch.Tensor:
        """Opacity of a view's pixels, float32 [H, W] in [0, 1]; see `TrainContext.alpha`."""
        own = self._scene.views[view]
        if factor == 1 and shift == STILL:
            if view not in self._held:
                self._held[view] = load_photo(self._path(own), 1)[:, :, 0].copy()
            pixels = self._held[view]
        else:
            pixels = load_photo(self._path(own), factor, shift)[:, :, 0].copy()
        return torch.from_numpy(pixels).float() / 255

    def _path(self, view: View) -> Path:
        return self._scene.root / ALPHA / Path(view.name).name


def write_scene(
    views: Views,
    points: NDArray[np.float64],
    colors: NDArray[np.uint8],
    folder: Path,
    note: str,
    up: Up,
) -> None:
    """Make a folder of renders a scene: cameras, parts and points.

    Args:
        views: As rendered.
        points: Stand for those of a reconstruction, world units [P, 3].
        colors: Theirs [P, 3].
        folder: Of the scene.
        note: What its photos are, for reports.
        up: Away from the ground.

    Raises:
        SpaceError: the disk is full.
    """
    publish(folder / POINTS, ply_bytes(points, colors))
    frames = [
        {
            "file_path": f"{IMAGES}/{name_of(part, number)}",
            "w": camera.width,
            "h": camera.height,
            "fl_x": camera.fx,
            "fl_y": camera.fy,
            "cx": camera.cx,
            "cy": camera.cy,
            "transform_matrix": _opengl(camera).tolist(),
        }
        for part, cameras in views.items()
        for number, camera in enumerate(cameras)
    ]
    lists: dict[str, list[str]] = {}
    for part, cameras in views.items():
        names = [f"{IMAGES}/{name_of(part, number)}" for number in range(len(cameras))]
        lists.setdefault(LISTS[part], []).extend(names)
    top = {NOTE: note, UP: up, "camera_model": "PINHOLE", "ply_file_path": POINTS}
    publish(folder / TRANSFORMS, json.dumps({**top, **lists, "frames": frames}))


def name_of(part: str, number: int) -> str:
    """Name of an image."""
    return f"{part}_{number:05d}.png"


def is_render(view: View) -> bool:
    """True for a view to train on that is a render and no photo."""
    return Path(view.name).name.startswith("train_")


def _opengl(camera: Camera) -> NDArray[np.float64]:
    """Camera to world with OpenGL axes, [4, 4]."""
    c2w = np.eye(4)
    c2w[:3, :3] = camera.w2c[:3, :3].T * [1, -1, -1]
    c2w[:3, 3] = camera.position
    return c2w
