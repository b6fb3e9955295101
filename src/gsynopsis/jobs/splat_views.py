"""Cameras of a finished splat for the jobs that take one, and a sheet of what they see."""

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from gsynopsis.cameras.given import places_beside, read_cameras
from gsynopsis.cameras.one_photo import of_one_photo
from gsynopsis.cameras.sheet import contact_sheet
from gsynopsis.cameras.viewpoints import Viewpoints, for_splats
from gsynopsis.errors import InputError
from gsynopsis.evaluation.metrics import Image8
from gsynopsis.evaluation.protocols import LevelRenderer
from gsynopsis.formats.axes import Up, up_text
from gsynopsis.formats.readers.base import SplatFile
from gsynopsis.model.splats import SplatModel
from gsynopsis.render.base import Renderer
from gsynopsis.scene.camera import Camera
from gsynopsis.scene.views import moved

SHEET_VIEWS = 24
"""Cameras in the contact sheet."""
SHEET_SIDE = 480
"""Longer side of their images before they are made smaller, pixels."""


@dataclass(frozen=True)
class Known:
    """Cameras that need not be found.

    Attributes:
        sources: Files or folders of them, and their cameras, likely ones first.
        asked: Somebody asked for them; else they lie beside the splats.
        lines: A line for each file that could not be read.
    """

    sources: tuple[tuple[Path, list[Camera]], ...] = ()
    asked: bool = False
    lines: tuple[str, ...] = ()


def known_cameras(source: Path, asked: Path | str | None) -> Known:
    """Cameras that somebody asked for, else those that lie where programs put them.

    Args:
        source: The file of splats.
        asked: A file or folder of cameras.

    Raises:
        InputError: what was asked for holds no cameras.
    """
    if asked is not None:
        return Known(((Path(asked), read_cameras(Path(asked))),), asked=True)
    found: list[tuple[Path, list[Camera]]] = []
    lines: list[str] = []
    for place in places_beside(source):
        try:
            found.append((place, read_cameras(place)))
        except InputError as error:
            lines.append(unused(error))
    return Known(tuple(found), lines=tuple(lines))


def splat_views(
    given: SplatFile,
    source: Path,
    known: Known,
    up: Up | None,
    count: int,
    width: int,
    renderer: Renderer | None = None,
) -> Viewpoints:
    """Cameras of splats: known ones that see something of them, else found ones.

    Where splats were made of one photo, cameras stand about its own.

    Args:
        given: The splats.
        source: Their file.
        known: Cameras that were asked for, or are there.
        up: Away from the ground, as somebody asked for it; None: see `for_splats`.
        count: Of found cameras.
        width: Of found cameras' images, pixels.
        renderer: Draws small images; None: the CPU's.

    Raises:
        InputError: cameras that were asked for see nothing of the scene, or it is only fog.
    """
    lines = list(known.lines)
    if not known.asked:
        beside, notes = of_one_photo(given, up, count, width)
        lines += notes
        if beside is not None:
            return replace(beside, lines=(*lines, *beside.lines))
    for place, cameras in known.sources:
        if any(given.shift):
            cameras = [moved(camera, -np.array(given.shift)) for camera in cameras]
        by = f"{place}" if known.asked else f"{place}, beside the splats"
        try:
            seen = for_splats(given, up, cameras, given_by=by, renderer=renderer)
            return replace(seen, lines=(*lines, *seen.lines))
        except InputError as error:
            if known.asked:
                raise
            lines.append(unused(error))
    found = for_splats(given, up, count=count, width=width, renderer=renderer)
    if found.fog:
        reason = "only fog: no camera sees enough, nothing is opaque from any place"
        raise InputError(source, found=reason, expected="a scene with surfaces")
    return replace(found, lines=(*lines, *found.lines))


def unused(error: InputError) -> str:
    """A line on cameras that are passed over."""
    return f"cameras beside it are not used: {error}"


def sheet_of(model: SplatModel, found: Viewpoints, renderer: Renderer) -> bytes:
    """The contact sheet of cameras as PNG."""
    some = evenly(found.cameras, SHEET_VIEWS)
    pictures = [painted(model, 0, camera.within(SHEET_SIDE), renderer) for camera in some]
    kind = "given" if found.given else "found"
    title = (
        f"{len(some)} of {len(found.cameras)} cameras that were {kind}; up is {up_text(found.up)}"
    )
    stream = io.BytesIO()
    contact_sheet(pictures, title).save(stream, "PNG")
    return stream.getvalue()


def painted(model: SplatModel, level: int, camera: Camera, renderer: Renderer) -> Image8:
    """A level as a camera sees it, on black, uint8 [H, W, 3]."""
    with torch.no_grad():
        return LevelRenderer(model, renderer).paint(camera, level)


def evenly(cameras: Sequence[Camera], count: int) -> list[Camera]:
    """So many cameras from the whole row, or all where there are fewer."""
    rows = np.linspace(0, len(cameras) - 1, min(count, len(cameras))).round().astype(int)
    return [cameras[row] for row in rows]
