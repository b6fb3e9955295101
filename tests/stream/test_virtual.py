import pytest

from gsynopsis.errors import SourceError, TransientError
from gsynopsis.stream.trace import parse_trace, steady
from gsynopsis.stream.transport import Ended, ReceivedBytes, TransportEvent
from gsynopsis.stream.virtual import Link, VirtualTransport, random_cuts

DATA = bytes(range(250)) * 4000  # 1 MB
FOREVER = float("inf")


def drain(transport: VirtualTransport) -> tuple[dict[int, bytes], dict[int, float]]:
    data: dict[int, bytes] = {}
    ends: dict[int, float] = {}
    while events := transport.wait(transport.now() + 100):
        for item in events:
            if isinstance(item, ReceivedBytes):
                data[item.ticket] = data.get(item.ticket, b"") + item.data
            else:
                assert item.error is None
                ends[item.ticket] = item.time
    return data, ends


def test_one_read_takes_set_up_round_trip_and_its_bytes() -> None:
    transport = VirtualTransport(DATA, Link(steady(8), round_trip=0.1))
    ticket = transport.begin(100, 500_100)
    data, ends = drain(transport)
    assert data[ticket] == DATA[100:500_100]
    assert ends[ticket] == pytest.approx(0.2 + 0.5)


def test_two_reads_share_the_link_equally() -> None:
    transport = VirtualTransport(DATA, Link(steady(8), round_trip=0.0))
    short, long = transport.begin(0, 100_000), transport.begin(100_000, 400_000)
    data, ends = drain(transport)
    assert data == {short: DATA[:100_000], long: DATA[100_000:400_000]}
    assert ends[short] == pytest.approx(0.2)
    assert ends[long] == pytest.approx(0.4)


def test_a_warm_connection_has_no_set_up() -> None:
    transport = VirtualTransport(DATA, Link(steady(8), round_trip=0.1))
    for _ in range(3):
        transport.begin(0, 1)
    drain(transport)
    began = transport.now()
    ticket = transport.begin(0, 1000)
    assert drain(transport)[1][ticket] - began == pytest.approx(0.101)


def test_silence_on_the_link_is_waited_for() -> None:
    trace = parse_trace("time_s,mbit_per_s\n0,8\n1,0\n5,8\n", "x", "x")
    transport = VirtualTransport(DATA * 2, Link(trace, round_trip=0.0))
    ticket = transport.begin(0, 1_500_000)
    assert drain(transport)[1][ticket] == pytest.approx(5.5)


def test_waiting_ends_at_its_deadline_and_a_cancelled_read_is_silent() -> None:
    transport = VirtualTransport(DATA, Link(steady(0.001), round_trip=0.5))
    ticket = transport.begin(0, 1000)
    assert transport.wait(0.25) == []
    assert transport.now() == 0.25
    transport.cancel(ticket)
    assert transport.wait(100.0) == []
    assert transport._carried == 0


def test_a_cut_breaks_the_read_at_its_byte_and_keeps_what_came() -> None:
    transport = VirtualTransport(DATA, Link(steady(8), cuts=(123_457,)))
    transport.begin(10, 900_000)
    events: list[TransportEvent] = []
    while more := transport.wait(100.0):
        events += more
    *pieces, ended = events
    data = b"".join(event.data for event in pieces if isinstance(event, ReceivedBytes))
    assert isinstance(ended, Ended)
    assert isinstance(ended.error, TransientError)
    assert "broke off" in str(ended.error)
    assert data == DATA[10 : 10 + 123_457]
    ticket = transport.begin(10 + len(data), 900_000)
    assert drain(transport)[0][ticket] == DATA[10 + len(data) : 900_000]


def test_a_range_outside_the_file_ends_with_an_error() -> None:
    transport = VirtualTransport(DATA, Link(steady(8)))
    transport.begin(len(DATA), len(DATA) + 1)
    (ended,) = transport.wait(FOREVER)
    assert isinstance(ended, Ended)
    assert isinstance(ended.error, SourceError)


def test_random_cuts_are_those_of_their_seed() -> None:
    cuts = random_cuts(1000, 20, 3)
    assert cuts == random_cuts(1000, 20, 3) != random_cuts(1000, 20, 4)
    assert list(cuts) == sorted(set(cuts))
    assert 1 <= cuts[0] <= cuts[-1] <= 1000
