"""Sources of bytes: the one method of the network, and the waits between tries.

A `ByteSource` reads a range of one file, on disk, in memory or on a server. Nothing here needs our
own server; any static host will do.
"""

import random
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from gsynopsis.errors import TransientError

PIECE = 1 << 16
"""Most bytes that a source hands over at once, so that progress is seen."""


class ByteSource(Protocol):
    """One file that can be read in ranges.

    Reads may run in several threads at once. A source keeps no state that changes the bytes; it
    may keep connections, which `close` gives back (a second `close` does nothing).
    """

    @property
    def name(self) -> str:
        """Name of the file in messages: its path or address."""
        ...

    @property
    def size(self) -> int | None:
        """Bytes of the file; None while unknown, e.g. before the first read."""
        ...

    def read(self, start: int, stop: int) -> Iterator[bytes]:
        """The bytes from `start` up to, not including, `stop`, in pieces and in order.

        The pieces together are the range, or an error is raised after the last good one; the next
        try then starts behind the bytes that have arrived.

        Args:
            start: First byte, at least 0.
            stop: End of the range, more than `start`; if the file ends before, so do the pieces.

        Raises:
            TransientError: it broke off or the server is busy; bytes before it are good.
            ChangedError: the file is not the one that earlier reads saw.
            SourceError: there is no such file or range; trying again is of no use.
        """
        ...

    def close(self) -> None:
        """Give connections back."""
        ...


@dataclass(frozen=True)
class Backoff:
    """Wait before a failed read is tried again.

    The wait doubles from `first` to at most `longest`; a random part of it, `jitter`, is left out,
    so that clients which failed together do not come back together.
    """

    first: float = 0.25
    """Seconds before the first repetition (ours: the first image is due within a second)."""
    longest: float = 8.0
    """Seconds (hls.js: 8)."""
    jitter: float = 0.5
    """Share of the wait that is random, 0 to 1."""
    tries: int = 8
    """Failures in a row without a single byte after which to give up (hls.js: up to 8)."""

    def delay(self, failures: int, after: float, chance: random.Random) -> float:
        """Seconds to wait after `failures` failures in a row.

        Args:
            failures: At least 1.
            after: Least wait, as the server demands, seconds.
            chance: Source of the jitter.
        """
        wait = min(self.longest, self.first * 2.0 ** min(failures - 1, 32))
        return max(after, wait * (1 - self.jitter * chance.random()))


def broken_off(name: str, got: int, wanted: int) -> TransientError:
    """The error of a body that ended before its end."""
    return TransientError(name, found=f"{got} bytes", expected=f"{wanted}", advice="broke off")
