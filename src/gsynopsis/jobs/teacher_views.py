"""Cameras from which a finished splat is rendered, to train on and to measure by."""

from collections.abc import Sequence

import numpy as np
import torch

from gsynopsis.cameras.placement import shown, subject_of
from gsynopsis.cameras.screening import Screen
from gsynopsis.formats.readers.base import SplatFile, rows_of
from gsynopsis.model.splats import SplatModel, SplatPart
from gsynopsis.render.base import Renderer
from gsynopsis.scene.camera import Camera
from gsynopsis.training.observer import Observer

WHOLE_VIEWS = 8
"""Cameras that see all of it, which come first."""
LOOKED_AT = 65_536
"""Splats that stand for all where it is told what a camera sees: those that fill most."""


def teacher_views(
    given: SplatFile,
    model: SplatModel,
    renderer: Renderer,
    counts: Sequence[int],
    width: int,
    observer: Observer,
) -> tuple[list[Camera], ...] | None:
    """Cameras of several sets, each from other places; the first also has some that see all.

    Args:
        given: The splats.
        model: Its finest level.
        renderer: Draws small images to see what cameras see.
        counts: Cameras of each set, about.
        width: Width of their images, pixels.
        observer: Hears what was left out.

    Returns:
        The sets; None where all cameras of one see nothing.
    """
    finest, part = given.levels[-1], model.part(-1)
    subject = subject_of(finest, given.up, given.environment)
    if len(finest) > LOOKED_AT:
        rows = np.sort(np.argsort(-shown(finest), kind="stable")[:LOOKED_AT])
        mask = torch.ones(LOOKED_AT, 1, dtype=torch.bool)
        some = SplatPart(mask, torch.ones(3), part.focals)
        model = SplatModel(rows_of(finest, rows), [some]).to(renderer.device)
    screened = Screen(model, subject, renderer).screened((WHOLE_VIEWS, *counts), width)
    if screened.blind:
        return None
    if screened.near + screened.empty:
        observer.on_message(f"note: {screened}; these are left out")
    whole, first, *others = screened.cameras
    return ([*whole, *first], *others)
