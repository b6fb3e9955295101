"""A source without a network: a file on a disk."""

from collections.abc import Iterator
from pathlib import Path

from gsynopsis.errors import SourceError
from gsynopsis.stream.source import PIECE


class FileSource:
    """A file on a disk, opened for each read."""

    def __init__(self, path: Path | str) -> None:
        """Keep the path; the file is opened when it is read, not before."""
        self._path = Path(path)

    @property
    def name(self) -> str:
        """The path."""
        return str(self._path)

    @property
    def size(self) -> int | None:
        """See `ByteSource.size`."""
        return self._path.stat().st_size if self._path.is_file() else None

    def read(self, start: int, stop: int) -> Iterator[bytes]:
        """See `ByteSource.read`."""
        try:
            with self._path.open("rb") as file:
                size = file.seek(0, 2)
                stop = clipped(self.name, start, stop, size)
                file.seek(start)
                for at in range(start, stop, PIECE):
                    piece = file.read(min(PIECE, stop - at))
                    if len(piece) != min(PIECE, stop - at):
                        raise SourceError(self.name, found="a file that shrank while it was read")
                    yield piece
        except OSError as error:
            found = error.strerror or error
            raise SourceError(self.name, found=found, expected="a readable file") from error

    def close(self) -> None:
        """Nothing to give back."""


def clipped(name: str, start: int, stop: int, size: int) -> int:
    """The end of a range within a file of `size` bytes.

    Raises:
        SourceError: it is empty or does not begin within the file.
    """
    if not 0 <= start < min(stop, size):
        found, expected = f"bytes {start} to {stop}", f"a range within {size} bytes"
        raise SourceError(name, "range", found=found, expected=expected)
    return min(stop, size)
