from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsynopsis.errors import TraceError
from gsynopsis.stream.trace import Trace, parse_trace, read_trace, shifted, steady

TRACES = Path(__file__).parents[3] / "shared" / "data" / "traces"
GOOD = "time_s,mbit_per_s\n0.0,8\n1.0,0\n3.0,16\n"


def test_a_trace_carries_what_its_rows_say_and_starts_again() -> None:
    trace = parse_trace(GOOD, "x.csv", "x")
    assert trace.period == 5.0
    assert [trace.bytes_by(t) for t in (0, 0.5, 1, 2.5, 3, 4, 5, 6)] == [
        0, 5e5, 1e6, 1e6, 1e6, 3e6, 5e6, 6e6,
    ]  # fmt: skip
    assert trace.mean == 1e6


def test_silence_passes_before_the_next_byte() -> None:
    trace = parse_trace(GOOD, "x.csv", "x")
    assert trace.time_of(1e6) == 1.0
    assert trace.time_of(1e6 + 2) == pytest.approx(3.000001)
    assert trace.time_of(5e6) == 5.0


rates = st.lists(st.sampled_from([0.0, 0.25, 3.0, 100.0]), min_size=1, max_size=6).filter(any)


@given(rates, st.floats(0, 1e8))
def test_time_of_is_the_first_time_that_has_the_bytes(values: list[float], amount: float) -> None:
    trace = Trace("x", np.arange(len(values), dtype=float), np.array(values) * 125e3, len(values))
    time = trace.time_of(amount)
    assert trace.bytes_by(time) == pytest.approx(amount, rel=1e-9, abs=1e-3)
    if amount > 1:
        assert trace.bytes_by(max(0.0, time * (1 - 1e-6) - 1e-6)) < amount


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty file"),
        ("time_s,mbit_per_s\n", "no rows"),
        ("a,b\n0,1\n", "header: found a,b"),
        (GOOD[:-1], "row 4: found no line end"),
        ("time_s,mbit_per_s\n0,1\n1\n", "row 3: found 1, expected two numbers"),
        ("time_s,mbit_per_s\n0,x\n", "row 2"),
        ("time_s,mbit_per_s\n0,-1\n", "row 2"),
        ("time_s,mbit_per_s\n0,nan\n", "row 2"),
        ("time_s,mbit_per_s\ninf,1\n", "row 2"),
        ("time_s,mbit_per_s\n1,1\n", "first time_s"),
        ("time_s,mbit_per_s\n0,1\n2,1\n2,1\n", "row 4: found a time that does not ascend"),
        ("time_s,mbit_per_s\n0,0\n1,0\n", "no throughput"),
    ],
)
def test_a_broken_trace_is_one_clear_error(text: str, words: str) -> None:
    with pytest.raises(TraceError, match=r"x\.csv") as caught:
        parse_trace(text, "x.csv", "x")
    assert words in str(caught.value)


def test_a_missing_or_binary_trace_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TraceError, match="No such file"):
        read_trace(tmp_path / "none.csv")
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(TraceError, match="not text"):
        read_trace(tmp_path / "b.csv")


def test_a_steady_link_has_one_speed() -> None:
    assert steady(8).bytes_by(3.25) == 3.25e6
    with pytest.raises(TraceError):
        steady(0)


@pytest.mark.skipif(not TRACES.is_dir(), reason="../shared/data/traces is not there")
def test_all_recorded_traces_are_read_and_have_their_documented_mean() -> None:
    table = (TRACES / "SOURCE.md").read_text()
    for path in sorted(TRACES.glob("*.csv")):
        row = next(line for line in table.splitlines() if line.startswith(f"| {path.name} |"))
        samples = float(row.split("|")[6])
        trace = read_trace(path)
        assert float(trace.rates.mean()) / 125e3 == pytest.approx(samples, rel=0.3)


@pytest.mark.parametrize("late", [0.0, 0.5, 1.0, 2.25, 3.0, 7.5])
def test_a_shifted_line_carries_what_the_line_carries_later(late: float) -> None:
    trace = parse_trace("time_s,mbit_per_s\n0,8\n1,0\n2,4\n", "x", "x")
    moved = shifted(trace, late)
    assert moved.period == trace.period
    for time in np.linspace(0, 7, 29):
        expected = trace.bytes_by(late + time) - trace.bytes_by(late)
        assert moved.bytes_by(time) == pytest.approx(expected, abs=1e-6)
        if expected:
            assert moved.bytes_by(moved.time_of(expected)) == pytest.approx(expected)
