"""The notes of a file's manifest: everything that a writer says about a scene, in one place.

Names of the notes that readers act on stand in `records.py`; docs/format.md says what they mean.
"""

import io
from collections.abc import Sequence

from PIL import Image, features

from gsynopsis import __version__
from gsynopsis.cameras.orbit import circle_of_cameras, circle_text, first_text, first_view
from gsynopsis.config import level_scale
from gsynopsis.container.notes.poster import poster_text
from gsynopsis.evaluation.metrics import Image8
from gsynopsis.evaluation.report import AtPhotoSize
from gsynopsis.model.training_focals import focals_text
from gsynopsis.model.view_bounds import view_bounds_of, view_bounds_text
from gsynopsis.records import (
    FIRST_NOTE,
    FOCALS_NOTE,
    ORBIT_NOTE,
    POSTER_NOTE,
    SEEN_NOTE,
    SHIFT_NOTE,
)
from gsynopsis.render.base import TrainingFocals
from gsynopsis.scene.camera import positions_of
from gsynopsis.training.state import TrainState

Up = tuple[float, float, float]
POSTER_SIDE = 48
"""Pixels of the longer side (ours: blurred over a window it shows no more with 64)."""
POSTER_QUALITY = 40
"""Quality of WebP, 0 to 100, at which an image takes 150 to 500 bytes."""


def training_notes(state: TrainState, preset: str, up: Up | None = None) -> dict[str, str]:
    """Notes of a file on its scene, its training, and the views that it was trained on.

    Args:
        state: Of the training.
        preset: Its name.
        up: Away from the ground, not zero; None: as the scene has it, else its cameras.
    """
    context = state.context
    scene, config = context.scene, context.config
    cameras = [scene.camera(view) for view in scene.train]
    circle = circle_of_cameras(cameras, scene.up if up is None else up)
    first = first_view(cameras, circle)
    view = next(v for v, c in zip(scene.train, cameras, strict=True) if c is first)
    eyes = positions_of(cameras)
    anchors, _ = state.model.placed()
    factor = max(1.0, max(first.width, first.height) / POSTER_SIDE)
    poster = poster_of(scene.image(view, factor))
    return {
        "scene": scene.name,
        "generator": f"gsynopsis {__version__}",
        "preset": preset,
        "seed": str(config.train.seed),
        "scale": f"{config.scale:g}",
        "units": "those of the photos' camera poses",
        "up": " ".join(f"{value:.6g}" for value in circle.up),
        ORBIT_NOTE: circle_text(circle),
        FIRST_NOTE: first_text(first),
        FOCALS_NOTE: focals_text(trained_focals(state)),
        SEEN_NOTE: view_bounds_text(view_bounds_of(eyes, anchors, state.model.frame.extent)),
        **({POSTER_NOTE: poster} if poster else {}),
        **({SHIFT_NOTE: shift_text(scene.shift)} if any(scene.shift) else {}),
    }


def shift_text(shift: Sequence[float]) -> str:
    """The note on a scene that was moved to its origin."""
    return " ".join(f"{value:.15g}" for value in shift)


def trained_focals(state: TrainState) -> list[TrainingFocals]:
    """Focal lengths of the training photos, of each level at its training resolution.

    While levels are made top down, those there are so far.
    """
    scene, config = state.context.scene, state.context.config
    ranges: list[TrainingFocals] = []
    for level in range(config.levels.count)[-len(state.model.parts) :]:
        scale = level_scale(config, level)
        lengths = [scene.camera(view, scale).focal_length for view in scene.train]
        ranges.append((min(lengths), max(lengths)))
    return ranges


def quality_notes(
    split: str,
    scale: float,
    size: tuple[int, int],
    photo: AtPhotoSize | None,
    *,
    masked: bool = False,
) -> dict[str, str]:
    """Notes on how the figures in a file were measured.

    Args:
        split: The rule that chose the held-out photos.
        scale: Photos were divided by this.
        size: Width and height of the pictures, pixels.
        photo: At which of the photos' own sizes, if at any.
        masked: `psnr_full` is inside of the photos' masks.
    """
    full = f"{size[0]} x {size[1]}"
    text = (
        f"held-out views by rule {split}, scale {scale:g}, 8 bits, black background; "
        f"full: pictures of {full}, own: level L of 0..M at scale {scale:g} times 2^(M-L)"
    )
    text += "; psnr_full inside of masks" if masked else ""
    notes = {"protocol": text, "pictures": full}
    if photo:
        notes["photos"] = f"{photo.width} x {photo.height}"
        some = f"{photo.views} of {photo.held_out} views"
        notes["protocol"] += f", photo: {notes['photos']}, the photos' own size, {some}"
    return notes


def poster_of(image: Image8) -> str:
    """The text of the tiny picture in a file; empty where Pillow cannot write WebP."""
    if not features.check("webp"):
        return ""
    picture = Image.fromarray(image)
    picture.thumbnail((POSTER_SIDE, POSTER_SIDE))
    stream = io.BytesIO()
    picture.save(stream, "WEBP", quality=POSTER_QUALITY, method=6)
    return poster_text(stream.getvalue())
