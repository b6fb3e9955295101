"""The fetcher over a scripted network: no sockets, no sleeps."""

import random
from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsynopsis.errors import ChangedError, SourceError, TransientError
from gsynopsis.stream.fetch import IN_FLIGHT, SLOW_SECONDS, STALL, FetchedRange, Fetcher
from gsynopsis.stream.source import Backoff
from gsynopsis.stream.trace import parse_trace, steady
from gsynopsis.stream.transport import Ended, ReceivedBytes, TransportEvent
from gsynopsis.stream.virtual import Link, VirtualTransport, random_cuts

DATA = random.Random(1).randbytes(600_000)


def fetcher(link: Link) -> Fetcher:
    return Fetcher(VirtualTransport(DATA, link), "a", seed=0)


def collect(fetch: Fetcher, spans: Sequence[tuple[int, int]]) -> list[FetchedRange]:
    todo, done = list(enumerate(spans)), []
    while todo or fetch.keys:
        while todo and fetch.free:
            key, span = todo.pop(0)
            fetch.request(key, *span)
        done += fetch.wait(1e6)
    return done


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 30))
def test_ranges_come_whole_and_nothing_twice_whatever_breaks(seed: int, count: int) -> None:
    spans = [(k * 60_000, (k + 1) * 60_000) for k in range(10)]
    fetch = fetcher(Link(steady(20), cuts=random_cuts(len(DATA), count, seed)))
    completed = {g.key: g.data for g in collect(fetch, spans)}
    assert completed == {k: DATA[a:b] for k, (a, b) in enumerate(spans)}
    assert fetch.received == len(DATA)
    assert fetch.retries == count


def test_no_more_than_three_are_under_way() -> None:
    fetch = fetcher(Link(steady(8)))
    for k in range(IN_FLIGHT):
        fetch.request(k, k, k + 1)
    with pytest.raises(ValueError, match="3 requests"):
        fetch.request(9, 0, 1)
    assert fetch.keys == (0, 1, 2)


def test_what_has_come_of_a_range_can_be_used_before_the_rest() -> None:
    fetch = fetcher(Link(steady(8), round_trip=0.0))
    fetch.request("a", 100, 500_000)
    while fetch.left("a") > 300_000:
        assert fetch.wait(1e6) == []
    data, time = fetch.received_so_far("a")
    assert data == DATA[100 : 100 + len(data)]
    assert len(data) == 499_900 - fetch.left("a") == fetch.kept
    assert time == fetch.transport.now()


def test_a_silent_read_is_asked_again_and_loses_nothing() -> None:
    trace = parse_trace("time_s,mbit_per_s\n0,8\n0.5,0\n20,8\n", "x", "x")
    fetch = fetcher(Link(trace, round_trip=0.01))
    (completed,) = collect(fetch, [(0, 550_000)])
    assert completed.data == DATA[:550_000]
    assert fetch.retries >= int((20 - 0.5) / (STALL + 8)) >= 1
    assert fetch.received == 550_000


class Refusing:
    """Transport on which every read fails at once."""

    size: int | None = None

    def __init__(self, error: SourceError) -> None:
        self.error, self.time, self.begun = error, 0.0, list[float]()
        self.open: list[int] = []

    def now(self) -> float:
        return self.time

    def begin(self, start: int, stop: int) -> int:
        self.begun.append(self.time)
        self.open.append(len(self.begun))
        return len(self.begun)

    def cancel(self, ticket: int) -> None:
        self.open = [t for t in self.open if t != ticket]

    def wait(self, until: float) -> Sequence[TransportEvent]:
        if self.open:
            return [Ended(self.open.pop(), self.error, self.time)]
        self.time = until
        return []

    def close(self) -> None:
        self.open = []


def waits_of(error: SourceError) -> list[float]:
    transport = Refusing(error)
    fetch = Fetcher(transport, "a", Backoff(jitter=0.0), seed=0)
    fetch.request("x", 0, 9)
    with pytest.raises(SourceError, match="gave up after 9 tries"):
        while True:
            fetch.wait(1e6)
    return [b - a for a, b in zip(transport.begun, transport.begun[1:], strict=False)]


def test_waits_double_up_to_their_longest_and_then_it_gives_up() -> None:
    assert waits_of(TransientError("a", found="503")) == [0.25, 0.5, 1, 2, 4, 8, 8, 8]


def test_a_wait_that_the_server_asked_for_is_kept() -> None:
    error = TransientError("a", found="503")
    error.after = 3.0
    assert waits_of(error) == [3, 3, 3, 3, 4, 8, 8, 8]


def test_jitter_shortens_a_wait_by_at_most_its_share() -> None:
    chance, rule = random.Random(0), Backoff()
    waits = [rule.delay(3, 0.0, chance) for _ in range(200)]
    assert 0.5 <= min(waits) < 0.55
    assert 0.95 < max(waits) <= 1.0


def test_a_final_error_is_raised_at_once() -> None:
    transport = Refusing(ChangedError("a", found="another version"))
    fetch = Fetcher(transport, "a")
    fetch.request("x", 0, 9)
    with pytest.raises(ChangedError):
        fetch.wait(1e6)
    assert len(transport.begun) == 1


class Dripping(Refusing):
    """Transport on which each read brings a byte every three seconds, for ever."""

    def wait(self, until: float) -> Sequence[TransportEvent]:
        self.time += 3.0
        return [ReceivedBytes(self.open[0], b"x", self.time)]


def test_a_host_that_drips_is_given_up_after_two_minutes() -> None:
    transport = Dripping(SourceError("a"))
    fetch = Fetcher(transport, "a")
    fetch.request("x", 0, 1 << 20)
    with pytest.raises(SourceError, match="a: found 40 bytes in 120 s, expected at least 128 a"):
        while True:
            fetch.wait(1e6)
    assert transport.time == SLOW_SECONDS


def test_all_has_to_be_there_by_the_deadline() -> None:
    transport = VirtualTransport(DATA, Link(steady(0.1)))
    fetch = Fetcher(transport, "a", seed=0, deadline=20.0)
    fetch.request("x", 0, len(DATA))
    with pytest.raises(SourceError, match=r"bytes within 20 s, expected all; allow more time"):
        while True:
            fetch.wait(1e6)
    assert 20.0 <= transport.now() < 21.0


def test_samples_measure_the_link() -> None:
    fetch = fetcher(Link(steady(8), round_trip=0.0))
    collect(fetch, [(0, 300_000), (300_000, 600_000)])
    total = sum(s.amount for s in fetch.samples), sum(s.seconds for s in fetch.samples)
    assert total[0] == pytest.approx(600_000, rel=0.05)
    assert total[0] / total[1] == pytest.approx(1e6, rel=0.02)


def test_a_link_that_rests_while_its_user_thinks_is_not_slow() -> None:
    """Two reads end together; the next begins a second later, before both ends are heard of."""
    transport = Told()
    fetch = Fetcher(transport, "a", seed=0)
    fetch.request("one", 0, 2000)
    fetch.request("two", 2000, 4000)
    transport.tells = [
        ReceivedBytes(1, DATA[:1000], 0.1),
        ReceivedBytes(1, DATA[1000:2000], 0.2),
        ReceivedBytes(2, DATA[2000:3000], 0.2),
        Ended(1, None, 0.2),
    ]
    fetch.wait(1e6)
    transport.time = 1.0
    fetch.request("three", 4000, 6000)
    transport.tells = [
        ReceivedBytes(2, DATA[3000:4000], 0.3),
        Ended(2, None, 0.3),
        ReceivedBytes(3, DATA[4000:5000], 1.1),
        ReceivedBytes(3, DATA[5000:6000], 1.2),
        Ended(3, None, 1.2),
    ]
    fetch.wait(1e6)
    assert sum(sample.seconds for sample in fetch.samples) == pytest.approx(0.3)
    assert sum(sample.amount for sample in fetch.samples) == 4000


class Told(Refusing):
    """Transport that reports what it is told to."""

    def __init__(self) -> None:
        super().__init__(SourceError("a"))
        self.tells = list[TransportEvent]()

    def wait(self, until: float) -> Sequence[TransportEvent]:
        return self.tells
