"""The tiny picture in a file, see `pack.poster`: the photo of the first view."""

import io
from typing import TYPE_CHECKING

from PIL import Image, features

from gsynopsis.pack.poster import poster_text

if TYPE_CHECKING:
    from gsynopsis.scene.scene import Scene

SIDE = 48
"""Pixels of the longer side (ours: blurred over a window it shows no more with 64)."""
QUALITY = 40
"""Of WebP, 0 to 100; with it a picture takes 150 to 500 bytes."""


def poster_of(scene: "Scene", view: int) -> str:
    """The text of the note for a photo; empty where Pillow cannot write WebP.

    Raises:
        SceneError: the photo cannot be read.
    """
    if not features.check("webp"):
        return ""
    camera = scene.camera(view)
    factor = max(1.0, max(camera.width, camera.height) / SIDE)
    picture = Image.fromarray(scene.image(view, factor))
    picture.thumbnail((SIDE, SIDE))
    stream = io.BytesIO()
    picture.save(stream, "WEBP", quality=QUALITY, method=6)
    return poster_text(stream.getvalue())
