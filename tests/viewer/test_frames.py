"""The viewer's frames a second."""

import json
from pathlib import Path

import pytest

from tests.viewer.node import needs_node, run_node

pytestmark = needs_node


@pytest.mark.parametrize(
    ("times", "rate"),
    [
        ([], 0),
        ([5.0], 0),
        # Two frames a hair apart were 10,000 a second when each distance was turned over.
        ([5.0, 5.1], 4),
        ([1000 / 60 * k for k in range(100)], 60),
        ([1000 / 60 * k + 16 * (k % 2) for k in range(100)], 60),
        ([333.0 * k for k in range(9)], 3),
        ([*(1000 / 60 * k for k in range(100)), 9000.0], 0),
    ],
)
def test_frames_a_second_are_those_of_the_last_second(
    times: list[float], rate: float, tmp_path: Path
) -> None:
    request = tmp_path / "request.json"
    request.write_text(json.dumps([times]))
    assert json.loads(run_node("frames.mjs", request)) == [pytest.approx(rate, rel=0.03)]
