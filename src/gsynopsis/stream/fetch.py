"""Ranges to bytes in spite of a network: at most three at once, repeated, resumed.

What has arrived of a range is kept when its connection breaks, so that the next read asks only for
the rest.
"""

import random
from collections import deque
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field

from gsynopsis.errors import SourceError, TransientError
from gsynopsis.stream.source import Backoff
from gsynopsis.stream.transport import ReceivedBytes, Transport

IN_FLIGHT = 3
"""Requests at once (Spark's pager has 3)."""
STALL = 4.0
"""Seconds without a byte after which a read counts as dead and is requested again (ours)."""
SLOWEST, SLOW_SECONDS = 128, 120.0
"""Least rate of a read, bytes a second over this many seconds (ours).

A host that drips a byte now and then would otherwise hold a client for days.
"""
DEADLINE = 3600.0
"""Default of the seconds after which a stream is given up (ours)."""
SAMPLES = 64
"""Measurements of throughput that are remembered."""
SAMPLE_SECONDS = 0.1
"""A measurement spans at least this (ours: shorter ones measure buffers, not the link)."""


@dataclass(frozen=True)
class Sample:
    """A measurement of throughput: `amount` bytes in `seconds` with a request under way."""

    amount: int
    seconds: float


@dataclass(frozen=True)
class FetchedRange:
    """A range that is complete."""

    key: Hashable
    data: bytes
    ended: float


@dataclass
class _Job:
    """A requested range: its bounds, the bytes so far, its read if one runs."""

    start: int
    stop: int
    data: bytearray = field(default_factory=bytearray)
    ticket: int = 0
    heard: float = 0.0
    asked: float = 0.0
    came: float = 0.0
    failures: int = 0
    again: float = 0.0
    clip: bool = False
    since: float = 0.0
    mark: int = 0


class Fetcher:
    """The one user of `Transport`; see the module.

    Attributes:
        received: Bytes that arrived, whatever became of them.
        retries: Reads that were repeated.
    """

    def __init__(
        self,
        transport: Transport,
        name: str,
        backoff: Backoff | None = None,
        seed: int | None = None,
        deadline: float = DEADLINE,
    ) -> None:
        """Takes the transport over; it is closed with this.

        Args:
            transport: Where reads run.
            name: What messages call the file.
            backoff: How long to wait after a failure.
            seed: Of the jitter; None takes the system's chance.
            deadline: Seconds on the transport's clock by which all has to be there.
        """
        self.transport, self._name = transport, name
        self._backoff, self._chance = backoff or Backoff(), random.Random(seed)
        self._deadline = deadline
        self._jobs: dict[Hashable, _Job] = {}
        self._whole: list[FetchedRange] = []
        self._tickets: dict[int, Hashable] = {}
        self.received = 0
        self.retries = 0
        self._samples: deque[Sample] = deque(maxlen=SAMPLES)
        self._since: float | None = None
        self._amount = 0

    @property
    def keys(self) -> tuple[Hashable, ...]:
        """Keys of requested ranges that are not delivered yet, oldest first."""
        return (*self._jobs, *(completed.key for completed in self._whole))

    @property
    def size(self) -> int | None:
        """Bytes of the file; None while unknown."""
        return self.transport.size

    @property
    def free(self) -> int:
        """Number of requests that may begin now."""
        return IN_FLIGHT - len(self._jobs)

    @property
    def samples(self) -> tuple[Sample, ...]:
        """Recent measurements of throughput, oldest first."""
        return tuple(self._samples)

    @property
    def kept(self) -> int:
        """Bytes that have arrived of ranges that are not complete."""
        return sum(len(job.data) for job in self._jobs.values())

    def left(self, key: Hashable) -> int:
        """Bytes that a range under way still lacks."""
        job = self._jobs.get(key)
        return job.stop - job.start - len(job.data) if job else 0

    def received_so_far(self, key: Hashable) -> tuple[bytes, float]:
        """Bytes so far of a range under way, and the time of the last of them, seconds."""
        job = self._jobs[key]
        return bytes(job.data), job.came

    def request(self, key: Hashable, start: int, stop: int, *, clip: bool = False) -> None:
        """Ask for a range.

        Args:
            key: Its name.
            start: First byte.
            stop: End of the range.
            clip: The file may end before; then the range ends there.
        """
        if key in self._jobs:
            raise ValueError(f"{key} is under way already")
        if self.free <= 0:
            raise ValueError(f"{IN_FLIGHT} requests are under way already")
        now = self.transport.now()
        if start == stop:
            self._whole.append(FetchedRange(key, b"", now))
            return
        job = _Job(start, stop, clip=clip, since=now)
        self._jobs[key] = job
        self._begin(key, job)

    def wait(self, until: float) -> Sequence[FetchedRange]:
        """Ranges that became complete; returns at the first event or at `until`.

        Raises:
            SourceError: a read failed for good, or too often in a row, or is too slow, or the
                deadline has passed.
        """
        if self._whole:
            done, self._whole = self._whole, []
            return done
        self._check_time()
        self._revive()
        alarms = [job.heard + STALL for job in self._jobs.values() if job.ticket]
        alarms += [job.again for job in self._jobs.values() if not job.ticket]
        done: list[FetchedRange] = []
        for event in self.transport.wait(min([until, *alarms])):
            key = self._tickets.get(event.ticket)
            if key is None:
                continue
            job = self._jobs[key]
            job.heard = event.time
            if isinstance(event, ReceivedBytes):
                self._take(job, event)
                continue
            self._stop(job)
            self._measure(event.time, over=True)
            whole = len(job.data) == job.stop - job.start
            if whole or (job.clip and job.data and event.error is None):
                del self._jobs[key]
                done.append(FetchedRange(key, bytes(job.data), event.time))
            else:
                self._failed(job, event.error, event.time)
        return done

    def close(self) -> None:
        """Stop everything."""
        self.transport.close()

    def _take(self, job: _Job, event: ReceivedBytes) -> None:
        job.data += event.data
        job.came = event.time
        job.failures = 0
        self.received += len(event.data)
        if self._since is None:
            # The wait for the first piece is the round trip, not the link's speed.
            self._since, self._amount = event.time, 0
        else:
            self._amount += len(event.data)
            self._measure(event.time, over=False)
        if len(job.data) > job.stop - job.start:
            found, wanted = f"{len(job.data)} bytes", job.stop - job.start
            raise SourceError(self._name, "range", found=found, expected=wanted)

    def _failed(self, job: _Job, error: SourceError | None, now: float) -> None:
        """Plan the next try, or give up."""
        if error is not None and not isinstance(error, TransientError):
            raise error
        job.failures += 1
        if job.failures > self._backoff.tries:
            advice = f"gave up after {job.failures} tries without a byte"
            reason = str(error).removeprefix(f"{self._name}: ") if error else "broke off"
            raise SourceError(self._name, found=reason, advice=advice) from error
        after = error.after if error else 0.0
        job.again = now + self._backoff.delay(job.failures, after, self._chance)

    def _revive(self) -> None:
        """Begin reads that are due for another try; give up those that are silent for too long."""
        now = self.transport.now()
        for key, job in self._jobs.items():
            if job.ticket and now >= job.heard + STALL:
                self._stop(job)
                self._failed(job, None, now)
            if not job.ticket and now >= job.again:
                self.retries += 1
                self._begin(key, job)

    def _check_time(self) -> None:
        """Give up at the deadline, and on a host that only drips."""
        now = self.transport.now()
        if self._jobs and now >= self._deadline:
            found = f"{self.received} bytes within {self._deadline:g} s"
            raise SourceError(self._name, found=found, expected="all; allow more time")
        for job in self._jobs.values():
            if now < job.since + SLOW_SECONDS:
                continue
            came, seconds = len(job.data) - job.mark, now - job.since
            if came < SLOWEST * seconds:
                found = f"{came} bytes in {seconds:.0f} s"
                expected = f"at least {SLOWEST} a second"
                raise SourceError(self._name, found=found, expected=expected)
            job.since, job.mark = now, len(job.data)

    def _begin(self, key: Hashable, job: _Job) -> None:
        now = self.transport.now()
        job.ticket = self.transport.begin(job.start + len(job.data), job.stop)
        job.heard = job.asked = now
        self._tickets[job.ticket] = key

    def _stop(self, job: _Job) -> None:
        self.transport.cancel(job.ticket)
        self._tickets.pop(job.ticket, None)
        job.ticket = 0

    def _measure(self, now: float, *, over: bool) -> None:
        """A sample of throughput over all reads together, about every tenth of a second."""
        if self._since is None:
            return
        seconds = now - self._since
        if self._amount and (seconds >= SAMPLE_SECONDS or (over and seconds > 0)):
            self._samples.append(Sample(self._amount, seconds))
            self._since, self._amount = now, 0
        # What was asked for since, while whoever asks was thinking, was not on the link yet.
        if over and all(self._jobs[key].asked > now for key in self._tickets.values()):
            self._since = None
