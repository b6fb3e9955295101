"""Trained Gaussians that several baselines begin with: trained once, read by the others."""

import io
import time
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from gsynopsis.container.writer import publish
from gsynopsis.errors import InputError
from gsynopsis.records import PlainGaussians

SPENT = "spent"
"""Of a file beside the values: seconds of its training, and of all threads."""


@dataclass
class Kept:
    """Trainings in a folder, by their steps, for tasks that are alike in all else.

    Attributes:
        folder: Made where it is not there.
        seconds: That the trainings took which were read.
        cpu_seconds: The same, of all threads.
    """

    folder: Path
    seconds: float = 0.0
    cpu_seconds: float = 0.0

    def grown(self, steps: int, train: Callable[[], PlainGaussians]) -> PlainGaussians:
        """What so many steps grow: read, or trained and kept for others.

        Raises:
            InputError: the file is damaged.
            SpaceError: the disk has no room.
        """
        path = self.folder / f"{steps}.npz"
        if path.is_file():
            return self._read(path)
        began = time.monotonic(), time.process_time()
        found = train()
        spent = time.monotonic() - began[0], time.process_time() - began[1]
        stream = io.BytesIO()
        values: dict[str, Any] = {**vars(found), SPENT: np.array(spent)}
        np.savez(stream, **values)
        self.folder.mkdir(parents=True, exist_ok=True)
        publish(stream.getvalue(), path)
        return found

    def _read(self, path: Path) -> PlainGaussians:
        try:
            with path.open("rb") as raw, np.load(raw) as file:
                values = {field.name: file[field.name] for field in fields(PlainGaussians)}
                seconds, cpu_seconds = file[SPENT].tolist()
        except (ValueError, KeyError, EOFError, OSError, zipfile.BadZipFile) as error:
            raise InputError(path, found=error, expected="trained Gaussians; remove it") from error
        self.seconds += seconds
        self.cpu_seconds += cpu_seconds
        return PlainGaussians(**values)
