"""Trained Gaussians that several baselines begin with: trained once, read by the others."""

import errno
import fcntl
import io
import time
import zipfile
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from gsynopsis.container.writer import publish
from gsynopsis.errors import InputError
from gsynopsis.records import PlainGaussians

UNLOCKABLE = {errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL}
"""Errors of file systems without locks; on those, two processes may train the same Gaussians."""
SPENT = "spent"
"""Suffix of the file beside the values: wall and processor seconds of its training."""


@dataclass
class TrainingCache:
    """Cache of trainings in a folder, by name, for tasks that are equal in all else.

    Attributes:
        folder: Created if missing.
        seconds: Wall time of the trainings that were read instead of run.
        cpu_seconds: Processor time of the same, all threads.
    """

    folder: Path
    seconds: float = 0.0
    cpu_seconds: float = 0.0

    def grown(self, name: str, train: Callable[[], PlainGaussians]) -> PlainGaussians:
        """Gaussians of a training: read, or trained and stored while other processes wait.

        Raises:
            InputError: the file is damaged.
            SpaceError: the disk has no room.
        """
        path = self.folder / f"{name}.npz"
        self.folder.mkdir(parents=True, exist_ok=True)
        with _alone(path.with_suffix(".lock")):
            return self._read(path) if path.is_file() else self._trained(path, train)

    def _trained(self, path: Path, train: Callable[[], PlainGaussians]) -> PlainGaussians:
        began = time.monotonic(), time.process_time()
        found = train()
        spent = time.monotonic() - began[0], time.process_time() - began[1]
        stream = io.BytesIO()
        values: dict[str, Any] = {**vars(found), SPENT: np.array(spent)}
        np.savez(stream, **values)
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


@contextmanager
def _alone(path: Path) -> Generator[None]:
    """One process at a time; the system releases the lock however it ends."""
    with path.open("w") as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX)
        except OSError as error:
            if error.errno not in UNLOCKABLE:
                raise
        yield
