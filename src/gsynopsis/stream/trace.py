"""Recorded bandwidth: reading a trace, and the link that it describes.

A trace is a CSV table `time_s,mbit_per_s` whose first time is 0; a throughput holds until the next
row, the last one as long as the one before it. A client that outlasts the trace starts it again.
"""

import csv
import io
import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gsynopsis.errors import TraceError

HEADER = ["time_s", "mbit_per_s"]
BYTES_PER_MBIT = 125_000.0
RATE_MAX = 1e6
"""Mbit/s; more than that is a mistake of units."""

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class Trace:
    """Throughput over time, repeated for ever.

    Attributes:
        name: What messages and tables call it.
        starts: Seconds at which each step begins, float64 [S], ascending from 0.
        rates: Bytes per second of each step, float64 [S], at least 0 and not all 0.
        period: Seconds after which the trace starts again.
    """

    name: str
    starts: Float64
    rates: Float64
    period: float

    @cached_property
    def _table(self) -> tuple[Float64, Float64]:
        """Times [S + 1] and the bytes carried by then [S + 1]."""
        times = np.append(self.starts, self.period)
        return times, np.concatenate([[0.0], np.cumsum(np.diff(times) * self.rates)])

    @property
    def mean(self) -> float:
        """Mean throughput, bytes per second."""
        return float(self._table[1][-1] / self.period)

    def bytes_by(self, time: float) -> float:
        """Bytes that the link carries from 0 to `time` seconds, which is at least 0."""
        times, volume = self._table
        turns, rest = divmod(time, self.period)
        return turns * float(volume[-1]) + float(np.interp(rest, times, volume))

    def time_of(self, amount: float) -> float:
        """The first second by which the link has carried `amount` bytes; inverse of `bytes_by`."""
        times, volume = self._table
        turns, rest = divmod(amount, float(volume[-1]))
        if rest == 0.0 and turns:
            turns, rest = turns - 1, float(volume[-1])
        step = max(1, int(np.searchsorted(volume, rest, side="left")))
        rate = float(self.rates[step - 1])
        inside = (rest - float(volume[step - 1])) / rate if rate else 0.0
        return turns * self.period + float(times[step - 1]) + inside


def shifted(trace: Trace, seconds: float) -> Trace:
    """The same link for a client that comes `seconds` later.

    Args:
        trace: Any.
        seconds: At least 0; whole periods change nothing.
    """
    late = seconds % trace.period
    if not late:
        return trace
    step = int(np.searchsorted(trace.starts, late, side="right")) - 1
    again = trace.starts < late
    starts = [[late], trace.starts[step + 1 :], trace.starts[again] + trace.period]
    rates = [trace.rates[step:], trace.rates[again]]
    name = f"{trace.name}+{late:g}"
    return Trace(name, np.concatenate(starts) - late, np.concatenate(rates), trace.period)


def steady(mbit_per_s: float, name: str = "") -> Trace:
    """A link of one speed.

    Raises:
        TraceError: the speed is not a number above 0.
    """
    if not 0 < mbit_per_s <= RATE_MAX:
        raise TraceError(name or "steady link", found=mbit_per_s, expected="Mbit/s above 0")
    label = name or f"{mbit_per_s:g} Mbit/s"
    return Trace(label, np.zeros(1), np.array([mbit_per_s * BYTES_PER_MBIT]), 1.0)


def read_trace(path: Path | str) -> Trace:
    """A trace from its CSV file, named after it.

    Raises:
        TraceError: the file cannot be read, is empty or truncated, or a value is impossible.
    """
    path = Path(path)
    try:
        text = path.read_text()
    except OSError as error:
        found = error.strerror or error
        raise TraceError(path, found=found, expected="a readable CSV file") from error
    except UnicodeDecodeError as error:
        raise TraceError(path, found="bytes that are not text", expected="a CSV table") from error
    return parse_trace(text, str(path), path.stem)


def parse_trace(text: str, where: str, name: str) -> Trace:
    """A trace from the text of its CSV table.

    Raises:
        TraceError: see `read_trace`; the message names the row.
    """
    rows = list(csv.reader(io.StringIO(text)))
    if not rows:
        raise TraceError(where, found="an empty file", expected=f"the header {','.join(HEADER)}")
    if [cell.strip() for cell in rows[0]] != HEADER:
        raise TraceError(where, "header", found=",".join(rows[0])[:60], expected=",".join(HEADER))
    if not text.endswith("\n"):
        last = f"row {len(rows)}"
        raise TraceError(where, last, found="no line end", expected="a whole file; copy it again")
    pairs = [_pair(row, where, number) for number, row in enumerate(rows[1:], start=2) if row]
    if not pairs:
        raise TraceError(where, found="no rows", expected="at least one")
    starts, rates = (np.array(column, np.float64) for column in zip(*pairs, strict=True))
    if starts[0] != 0:
        raise TraceError(where, "first time_s", found=starts[0], expected=0)
    if (np.diff(starts) <= 0).any():
        row = 3 + int(np.argmax(np.diff(starts) <= 0))
        raise TraceError(where, f"row {row}", found="a time that does not ascend")
    if not rates.any():
        raise TraceError(where, found="no throughput at all", expected="one above 0")
    last = float(starts[-1] - starts[-2]) if len(starts) > 1 else 1.0
    return Trace(name, starts, rates * BYTES_PER_MBIT, float(starts[-1]) + last)


def _pair(row: list[str], where: str, number: int) -> tuple[float, float]:
    """Time and throughput of a row."""
    try:
        time, rate = map(float, row)
    except ValueError as error:
        found, expected = ",".join(row)[:60], "two numbers; a truncated file? copy it again"
        raise TraceError(where, f"row {number}", found=found, expected=expected) from error
    if not (math.isfinite(time) and 0 <= rate <= RATE_MAX):
        found, expected = ",".join(row)[:60], f"finite seconds and 0 to {RATE_MAX:g} Mbit/s"
        raise TraceError(where, f"row {number}", found=found, expected=expected)
    return time, rate
