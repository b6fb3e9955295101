import pytest

from gsynopsis.errors import SourceError, TransientError
from gsynopsis.stream.lines import Arrived, Ended
from gsynopsis.stream.trace import parse_trace, steady
from gsynopsis.stream.virtual import Link, TraceSource, VirtualLines, random_cuts

DATA = bytes(range(250)) * 4000  # 1 MB
FOREVER = float("inf")


def drain(lines: VirtualLines) -> tuple[dict[int, bytes], dict[int, float]]:
    data: dict[int, bytes] = {}
    ends: dict[int, float] = {}
    while happened := lines.wait(lines.now() + 100):
        for item in happened:
            if isinstance(item, Arrived):
                data[item.ticket] = data.get(item.ticket, b"") + item.data
            else:
                assert item.error is None
                ends[item.ticket] = item.time
    return data, ends


def test_one_read_takes_set_up_round_trip_and_its_bytes() -> None:
    source = TraceSource(DATA, Link(steady(8), round_trip=0.1))
    assert b"".join(source.read(100, 500_100)) == DATA[100:500_100]
    assert source.time == pytest.approx(0.2 + 0.5)


def test_two_reads_share_the_link_equally() -> None:
    lines = VirtualLines(DATA, Link(steady(8), round_trip=0.0))
    short, long = lines.begin(0, 100_000), lines.begin(100_000, 400_000)
    data, ends = drain(lines)
    assert data == {short: DATA[:100_000], long: DATA[100_000:400_000]}
    assert ends[short] == pytest.approx(0.2)
    assert ends[long] == pytest.approx(0.4)


def test_a_warm_connection_has_no_set_up() -> None:
    lines = VirtualLines(DATA, Link(steady(8), round_trip=0.1))
    for _ in range(3):
        lines.begin(0, 1)
    drain(lines)
    began = lines.now()
    ticket = lines.begin(0, 1000)
    assert drain(lines)[1][ticket] - began == pytest.approx(0.101)


def test_silence_on_the_link_is_waited_for() -> None:
    trace = parse_trace("time_s,mbit_per_s\n0,8\n1,0\n5,8\n", "x", "x")
    lines = VirtualLines(DATA * 2, Link(trace, round_trip=0.0))
    ticket = lines.begin(0, 1_500_000)
    assert drain(lines)[1][ticket] == pytest.approx(5.5)


def test_waiting_ends_at_its_deadline_and_a_cancelled_read_is_silent() -> None:
    lines = VirtualLines(DATA, Link(steady(0.001), round_trip=0.5))
    ticket = lines.begin(0, 1000)
    assert lines.wait(0.25) == []
    assert lines.now() == 0.25
    lines.cancel(ticket)
    assert lines.wait(100.0) == []
    assert lines.carried == 0


def test_a_cut_breaks_the_read_at_its_byte_and_keeps_what_came() -> None:
    source = TraceSource(DATA, Link(steady(8), cuts=(123_457,)))
    got = b""
    with pytest.raises(TransientError, match="broke off"):
        for piece in source.read(10, 900_000):
            got += piece
    assert got == DATA[10 : 10 + 123_457]
    assert b"".join(source.read(10 + len(got), 900_000)) == DATA[10 + len(got) : 900_000]


def test_a_range_outside_the_file_ends_with_an_error() -> None:
    lines = VirtualLines(DATA, Link(steady(8)))
    lines.begin(len(DATA), len(DATA) + 1)
    (ended,) = lines.wait(FOREVER)
    assert isinstance(ended, Ended)
    assert isinstance(ended.error, SourceError)


def test_random_cuts_are_those_of_their_seed() -> None:
    cuts = random_cuts(1000, 20, 3)
    assert cuts == random_cuts(1000, 20, 3) != random_cuts(1000, 20, 4)
    assert list(cuts) == sorted(set(cuts))
    assert 1 <= cuts[0] <= cuts[-1] <= 1000
