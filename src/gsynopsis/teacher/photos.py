"""Photos that teach beside renders: those of the scene that a finished splat was made of."""

import hashlib
import json
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from gsynopsis.errors import InputError
from gsynopsis.evaluation.metrics import psnr
from gsynopsis.evaluation.protocols import LevelRenderer
from gsynopsis.model.splats import SplatModel
from gsynopsis.render.base import Renderer
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.scene import Scene
from gsynopsis.scene.views import moved
from gsynopsis.teacher.renders import Photos

COMPARED = 8
"""Photos that are compared with the input's renders before anything is trained."""
NEARER = 1.0
"""Least difference in PSNR between the photo of a render's own camera and those of others, dB."""
Bytes = NDArray[np.uint8]


class ScenePhotos:
    """Photos of a scene in the coordinates of a file of splats, at the size of its renders."""

    def __init__(self, scene: Scene, side: int, shift: Sequence[float]) -> None:
        """Nothing is decoded yet.

        Args:
            scene: The photos; masks say which of their pixels count.
            side: Longer side of photos at most, pixels.
            shift: What was taken from the coordinates of the splats, world units [3].
        """
        self.scene = scene
        self._by = np.array(scene.shift) - np.array(shift)
        sizes = [(view.camera.width, view.camera.height) for view in scene.views]
        self._factors = [max(1.0, max(size) / side) for size in sizes]

    @property
    def parts(self) -> Photos:
        """The parts of a folder of renders that are photos."""
        train, test = self.scene.train, self.scene.test
        return {
            "photos": lambda number, render: self.pixels(train[number], render),
            "test": lambda number, render: self.pixels(test[number], render),
        }

    def digest(self) -> str:
        """Identity of the photos: their names, and which are held out."""
        scene, views = self.scene, self.scene.views
        names = [[views[v].name for v in part] for part in (scene.train, scene.test)]
        return hashlib.blake2b(json.dumps(names).encode(), digest_size=16).hexdigest()

    def cameras(self, views: Sequence[int]) -> list[Camera]:
        """Cameras of some views, for photos of this size."""
        return [moved(self.scene.camera(v, self._factors[v]), self._by) for v in views]

    def pixels(self, view: int, render: Bytes) -> Bytes:
        """The photo of a view, uint8 [H, W, 3]; outside of its mask the input's own render.

        Raises:
            SceneError: the pixel data cannot be decoded.
        """
        photo = self.scene.image(view, self._factors[view])
        mask = self.scene.mask(view, self._factors[view])
        if mask is None:
            return photo
        weight = mask[:, :, None]
        return np.rint(weight * photo + (1 - weight) * render).astype(np.uint8)

    def check_world(self, model: SplatModel, renderer: Renderer) -> str:
        """A line on how near the input's renders are to the photos.

        Raises:
            InputError: renders are no nearer to their own photos than to others.
            SceneError: the pixel data cannot be decoded.
        """
        train = self.scene.train
        some = train[:: -(-len(train) // COMPARED)]
        painter = LevelRenderer(model, renderer)
        with torch.no_grad():
            renders = [painter.paint(camera, 0) for camera in self.cameras(some)]
        photos = [self.pixels(v, render) for v, render in zip(some, renders, strict=True)]
        own = [psnr(render, photo) for render, photo in zip(renders, photos, strict=True)]
        others = [
            psnr(render, photo)
            for i, render in enumerate(renders)
            for j, photo in enumerate(photos)
            if i != j and render.shape == photo.shape
        ]
        near = float(np.mean(own))
        if others and near < float(np.mean(others)) + NEARER:
            raise InputError(
                self.scene.root,
                "photos",
                found=f"renders with {near:.1f} dB of their own photos and "
                f"{float(np.mean(others)):.1f} dB of others",
                expected="photos of what the splats show, with cameras in the same world",
                advice="leave --scene out to train on renders alone",
            )
        return f"renders of the input have {near:.1f} dB of {len(some)} of the scene's photos"
