"""Bounds of option values, and optional packages that a command needs."""

from collections.abc import Generator
from contextlib import contextmanager
from typing import Literal

from gsynopsis.errors import MissingExtraError, SettingError

Backend = Literal["auto", "cpu", "reference", "cuda", "webgpu"]
"""As `render.choose.RendererName`, which needs PyTorch."""


@contextmanager
def with_training() -> Generator[None]:
    """Imports of what trains or renders, for one `with` block.

    Raises:
        MissingExtraError: a package of the extra `train` is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise MissingExtraError(error.name or "torch", "train") from error


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
