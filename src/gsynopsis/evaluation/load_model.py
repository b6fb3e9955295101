"""A `.gsyn` file with all its levels, ready to be rendered."""

from dataclasses import dataclass
from pathlib import Path

from gsynopsis.container import read_gsyn
from gsynopsis.model.splats import FileModel, decoder_of
from gsynopsis.records import LevelSet
from gsynopsis.render.base import Renderer
from gsynopsis.render.choose import RendererName, make_renderer


@dataclass(frozen=True)
class Opened:
    """A file's levels, its model on the renderer's device, and the renderer."""

    levels: LevelSet
    decoder: FileModel
    renderer: Renderer


def open_levels(file: Path, backend: RendererName = "auto") -> Opened:
    """Read a file and put its model on the renderer's device.

    Raises:
        FormatError: the file is damaged.
        InputError: there is no such file.
    """
    levels = read_gsyn(file)
    renderer = make_renderer(backend, budgeted=True)
    return Opened(levels, decoder_of(levels).to(renderer.device), renderer)
