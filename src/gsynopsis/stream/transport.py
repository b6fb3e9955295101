"""Several reads at once on one clock: the contract, and the real one with threads.

A session requests ranges and waits for events. Behind it is either the world (threads that read a
`ByteSource`, the wall clock) or a trace (`stream/virtual.py`, no sockets, no sleeps).
"""

import queue
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from gsynopsis.errors import SourceError
from gsynopsis.stream.source import ByteSource


@dataclass(frozen=True)
class ReceivedBytes:
    """Bytes of a read, in order."""

    ticket: int
    data: bytes
    time: float


@dataclass(frozen=True)
class Ended:
    """A read is over: `error` is None if all of it has arrived."""

    ticket: int
    error: SourceError | None
    time: float


TransportEvent = ReceivedBytes | Ended


class Transport(Protocol):
    """Reads that run side by side. Times are seconds since the first one began, or earlier."""

    @property
    def size(self) -> int | None:
        """Bytes of the file, as `ByteSource.size`; a host that knows tells it with the first."""
        ...

    def now(self) -> float:
        """The time."""
        ...

    def begin(self, start: int, stop: int) -> int:
        """Start reading a range; the ticket under which it will report."""
        ...

    def cancel(self, ticket: int) -> None:
        """Stop a read; it reports nothing more. One that has ended is not an error."""
        ...

    def wait(self, until: float) -> Sequence[TransportEvent]:
        """The next events, in order of time: waits for them, at most until `until`.

        An empty answer means that nothing happened by then.
        """
        ...

    def close(self) -> None:
        """Stop all reads."""
        ...


class ThreadTransport:
    """Reads of a real source, each in a thread of its own; the source is closed with it."""

    def __init__(self, source: ByteSource) -> None:
        """The clock stands at 0 until the first read begins."""
        self._source = source
        self._began: float | None = None
        self._events: queue.SimpleQueue[TransportEvent] = queue.SimpleQueue()
        self._stop: dict[int, threading.Event] = {}
        self._count = 0

    @property
    def size(self) -> int | None:
        """See `Transport.size`."""
        return self._source.size

    def now(self) -> float:
        """Seconds since the first read began."""
        return 0.0 if self._began is None else time.monotonic() - self._began

    def begin(self, start: int, stop: int) -> int:
        """See `Transport.begin`."""
        if self._began is None:
            self._began = time.monotonic()
        self._count += 1
        ticket, flag = self._count, threading.Event()
        self._stop[ticket] = flag
        threading.Thread(
            target=self._read, args=(ticket, start, stop, flag), daemon=True, name=f"read-{ticket}"
        ).start()
        return ticket

    def cancel(self, ticket: int) -> None:
        """See `Transport.cancel`; the thread ends with the next piece."""
        flag = self._stop.pop(ticket, None)
        if flag is not None:
            flag.set()

    def wait(self, until: float) -> Sequence[TransportEvent]:
        """See `Transport.wait`."""
        while True:
            left = until - self.now()
            try:
                events = [self._events.get(timeout=max(0.0, left))]
            except queue.Empty:
                return []
            while not self._events.empty():
                events.append(self._events.get())
            events = [event for event in events if event.ticket in self._stop]
            for event in events:
                if isinstance(event, Ended):
                    self._stop.pop(event.ticket, None)
            if events:
                return events

    def close(self) -> None:
        """See `Transport.close`."""
        for ticket in list(self._stop):
            self.cancel(ticket)
        self._source.close()

    def _read(self, ticket: int, start: int, stop: int, flag: threading.Event) -> None:
        error: SourceError | None = None
        try:
            for piece in self._source.read(start, stop):
                if flag.is_set():
                    return
                self._events.put(ReceivedBytes(ticket, piece, self.now()))
        except SourceError as failure:
            error = failure
        except Exception as failure:
            # A thread has nobody to raise to: whatever it was, the session must hear of it.
            error = SourceError(self._source.name, found=f"{type(failure).__name__}: {failure}")
        self._events.put(Ended(ticket, error, self.now()))
