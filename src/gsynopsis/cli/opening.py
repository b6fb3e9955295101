"""A `.gsyn` file to something that draws: level set, model, renderer.

Imports of the heavy rooms stand inside the functions, so that `--help` and `info` need no torch.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from gsynopsis.errors import MissingExtraError, SettingError

if TYPE_CHECKING:
    from gsynopsis.evaluate.base import Decoder
    from gsynopsis.records import LevelSet
    from gsynopsis.render.base import Renderer

Backend = Literal["auto", "cpu", "reference", "cuda"]
Split = Literal["every8", "bungee", "none"]


@dataclass(frozen=True)
class Opened:
    """A file that is ready to be drawn."""

    levels: "LevelSet"
    decoder: "Decoder"
    renderer: "Renderer"


def open_file(file: Path, backend: Backend) -> Opened:
    """Read a file and put its model on the renderer's device.

    Raises:
        FormatError: the file is damaged.
        InputError: there is no such file.
        MissingExtraError: PyTorch is not installed.
    """
    from gsynopsis.pack import read_gsyn

    levels = read_gsyn(file)
    try:
        import torch  # noqa: F401  # pyright: ignore[reportUnusedImport]
    except ImportError as error:
        raise MissingExtraError("PyTorch", "train") from error
    from gsynopsis.model.build import model_from_levels
    from gsynopsis.render.choose import make_renderer

    renderer = make_renderer(backend, budgeted=True)
    model = model_from_levels(levels).to(renderer.device)
    return Opened(levels, model, renderer)


def positive(option: str, value: float) -> float:
    """The value, if it is a finite number above zero.

    Raises:
        SettingError: it is not.
    """
    if not 0 < value < float("inf"):
        raise SettingError(option, found=value, expected="a number above 0")
    return value


def bounded(option: str, value: float, low: float, high: float) -> float:
    """The value, if it lies between two others.

    Raises:
        SettingError: it does not.
    """
    if not low <= value <= high:
        raise SettingError(option, found=value, expected=f"{low:,} to {high:,}")
    return value
