"""A link of recorded bandwidth on a virtual clock: hours of streaming in a moment, repeatable.

The link is shared equally by the reads that are on it. A read's first byte comes a round trip
after it was begun (another one where it needs a new connection), and connections may break at given
amounts of carried bytes. The server's throttle (`serve/throttle.py`) behaves the same with sockets.
"""

import random
from collections.abc import Sequence
from dataclasses import dataclass, field

from gsynopsis.errors import SourceError
from gsynopsis.stream.local import clipped
from gsynopsis.stream.source import broken_off
from gsynopsis.stream.trace import Trace
from gsynopsis.stream.transport import Ended, ReceivedBytes, TransportEvent

QUANTUM = 1 << 12
"""Bytes after which a read reports."""
DUST = 1e-6
"""Bytes that rounding may leave over."""


@dataclass(frozen=True)
class Link:
    """A trace and other properties of a network.

    Attributes:
        trace: Throughput over time.
        round_trip: Seconds from a request to the first byte of its answer.
        cuts: Total bytes of the link at which it breaks the connection that is sending, ascending.
    """

    trace: Trace
    round_trip: float = 0.05
    cuts: tuple[int, ...] = ()


def random_cuts(total: int, count: int, seed: int) -> tuple[int, ...]:
    """`count` amounts of bytes, uniform between 1 and `total`, ascending and different."""
    chance = random.Random(seed)
    return tuple(sorted(chance.sample(range(1, total + 1), min(count, total))))


@dataclass
class _Read:
    """A read on the link: where it is, when it may start, bytes since it last reported."""

    start: int
    stop: int
    ready: float
    sent: float = 0.0
    reported: int = field(default=0)

    @property
    def due(self) -> float:
        """Bytes until it reports."""
        return min(self.stop - self.start, self.reported + QUANTUM) - self.sent


class VirtualTransport:
    """`Transport` over bytes in memory and a link; see the module."""

    def __init__(self, data: bytes, link: Link, name: str = "trace") -> None:
        """The clock stands at 0 and moves only in `wait`."""
        self._data, self._link, self._name = memoryview(data), link, name
        self._time = 0.0
        self._count = 0
        self._carried = 0.0
        self._cuts = list(link.cuts)
        self._idle = 0
        self._reads: dict[int, _Read] = {}
        self._refused: list[TransportEvent] = []

    @property
    def size(self) -> int:
        """See `Transport.size`."""
        return len(self._data)

    def now(self) -> float:
        """Virtual seconds."""
        return self._time

    def begin(self, start: int, stop: int) -> int:
        """See `Transport.begin`."""
        self._count += 1
        try:
            stop = clipped(self._name, start, stop, len(self._data))
        except SourceError as error:
            self._refused.append(Ended(self._count, error, self._time))
            return self._count
        turns = 1 if self._idle > 0 else 2
        self._idle = max(0, self._idle - 1)
        ready = self._time + turns * self._link.round_trip
        self._reads[self._count] = _Read(start, stop, ready)
        return self._count

    def cancel(self, ticket: int) -> None:
        """See `Transport.cancel`."""
        self._reads.pop(ticket, None)

    def wait(self, until: float) -> Sequence[TransportEvent]:
        """See `Transport.wait`; moves the clock."""
        if self._refused:
            events, self._refused = self._refused, []
            return events
        while self._time < until:
            events = self._step(until)
            if events:
                return events
        return []

    def close(self) -> None:
        """See `Transport.close`."""
        self._reads.clear()

    def _step(self, until: float) -> list[TransportEvent]:
        """Move to the next moment at which something changes; the events a client sees."""
        active = {t: r for t, r in self._reads.items() if r.ready <= self._time}
        moments = [r.ready for r in self._reads.values() if r.ready > self._time]
        before = self._link.trace.bytes_by(self._time)
        if active:
            due = min(read.due for read in active.values())
            share = due * len(active)
            if self._cuts:
                share = min(share, max(0.0, self._cuts[0] - self._carried))
            moments.append(max(self._time, self._link.trace.time_of(before + share)))
        self._time, moved = min([until, *moments]), self._time
        if not active:
            return []
        amount = self._link.trace.bytes_by(self._time) - before if self._time > moved else 0.0
        self._carried += amount
        for read in active.values():
            read.sent = min(read.sent + amount / len(active), read.stop - read.start)
        return self._reports(active)

    def _reports(self, active: dict[int, _Read]) -> list[TransportEvent]:
        events: list[TransportEvent] = []
        for ticket, read in active.items():
            if read.due <= DUST:
                read.sent = float(round(read.sent))
                events.append(self._flush(ticket, read))
            if read.sent >= read.stop - read.start:
                events.append(Ended(ticket, None, self._time))
                del self._reads[ticket]
                self._idle += 1
        if self._cuts and self._carried >= self._cuts[0] - DUST:
            self._cuts.pop(0)
            events += self._cut()
        return events

    def _cut(self) -> list[TransportEvent]:
        """The oldest read that is on the link breaks; its connection is to be set up again."""
        broken = next((t for t, r in self._reads.items() if r.ready <= self._time), None)
        if broken is None:
            return []
        read = self._reads.pop(broken)
        events: list[TransportEvent] = []
        if int(read.sent) > read.reported:
            events.append(self._flush(broken, read))
        error = broken_off(self._name, int(read.sent), read.stop - read.start)
        return [*events, Ended(broken, error, self._time)]

    def _flush(self, ticket: int, read: _Read) -> ReceivedBytes:
        """New bytes of a read since its last report."""
        first, last = read.start + read.reported, read.start + int(read.sent)
        read.reported = int(read.sent)
        return ReceivedBytes(ticket, bytes(self._data[first:last]), self._time)
