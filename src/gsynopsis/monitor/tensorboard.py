"""A training for TensorBoard: loss, PSNR, held-out PSNR and a picture, as its event files."""

import importlib
from pathlib import Path
from typing import Any

from gsynopsis.errors import MissingExtraError
from gsynopsis.files import inner_folder
from gsynopsis.monitor.history import Snapshot

BOARD = "tensorboard"
"""Folder in a run's."""


def load_writer() -> Any:
    """The class that writes event files.

    Raises:
        MissingExtraError: TensorBoard is not installed.
    """
    try:
        return importlib.import_module("torch.utils.tensorboard").SummaryWriter
    except ImportError as error:
        raise MissingExtraError("tensorboard", BOARD) from error


class TensorBoardWriter:
    """Writer of snapshots: `tensorboard --logdir RUN` shows it."""

    def __init__(self, run: Path) -> None:
        """Events go into `run`/tensorboard, beside those of the same training before a stop.

        Raises:
            MissingExtraError: TensorBoard is not installed.
        """
        self._writer: Any = load_writer()(str(inner_folder(run, BOARD)))

    def on_snapshot(self, snapshot: Snapshot) -> None:
        """Write it, at once."""
        self._writer.add_scalar("loss", snapshot.loss, snapshot.step)
        if snapshot.psnr is not None:
            self._writer.add_scalar("held-out PSNR, dB", snapshot.psnr, snapshot.step)
        pictures = (("rendering", snapshot.picture), ("photo", snapshot.photo))
        for name, picture in pictures:
            self._writer.add_image(name, picture, snapshot.step, dataformats="HWC")
        self._writer.flush()

    def close(self) -> None:
        """Give the file back."""
        self._writer.close()
