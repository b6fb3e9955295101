"""The range table of RFC 9110 §14.1.2 and §14.2, for a file of 1000 bytes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsynopsis.serve.ranges import PARTS_MAX, plain_range

TABLE = {
    "bytes=0-0": "bytes=0-0",
    "bytes=0-499": "bytes=0-499",
    "bytes=500-999": "bytes=500-999",
    "bytes=-500": "bytes=500-999",
    "bytes=9500-": "unsatisfiable",
    "bytes=990-": "bytes=990-999",
    "bytes=0-": "bytes=0-999",
    "bytes=0-0,-1": "bytes=0-0,999-999",
    "bytes= 0-0, 5-9 ,,": "bytes=0-0,5-9",
    "bytes=5-9,0-0": "bytes=0-0,5-9",
    "bytes=0-,0-,0-": "bytes=0-999",
    "bytes=0-4,3-7,8-9,20-": "bytes=0-9,20-999",
    "BYTES=1-2": "bytes=1-2",
    "bytes=-0": "unsatisfiable",
    "bytes=-2000": "bytes=0-999",
    "bytes=0-99999999999999999999999999": "bytes=0-999",
    "bytes=99999999999999999999999999-": "unsatisfiable",
    "bytes=1000-1000": "unsatisfiable",
    "bytes=2-5,2000-": "bytes=2-5",
    "bytes=5-2": "whole",
    "bytes=": "whole",
    "bytes=-": "whole",
    "bytes=a-b": "whole",
    "bytes=1-2-3": "whole",
    "bytes=0x1-2": "whole",
    "bytes=+1-2": "whole",
    "bytes=١-٢": "whole",
    "bytes": "whole",
    "items=0-5": "whole",
    "": "whole",
    "bytes=" + ",".join(["1-2"] * (PARTS_MAX + 1)): "whole",
}


@pytest.mark.parametrize("header", TABLE)
def test_the_table(header: str) -> None:
    found = plain_range(header, 1000)
    if not isinstance(found, str):
        found = "bytes=" + ",".join(f"{start}-{stop - 1}" for start, stop in found)
    assert found == TABLE[header]


def test_an_empty_file_satisfies_no_range() -> None:
    assert {plain_range(h, 0) for h in ("bytes=0-", "bytes=-1", "bytes=0-0")} == {"unsatisfiable"}


@given(st.text("bytes=0123456789-, ", max_size=30), st.integers(0, 60))
def test_whatever_is_asked_the_parts_lie_within_the_file_and_apart(text: str, size: int) -> None:
    meaning = plain_range(f"bytes={text}", size)
    if isinstance(meaning, str):
        return
    ends = [end for part in meaning for end in part]
    assert ends == sorted(set(ends)) and ends[0] >= 0 and ends[-1] <= size
