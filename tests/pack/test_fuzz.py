"""A part of benchmarks/fuzz.py in every test run, in a process whose memory is capped."""

import json
import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "fuzz.py"


def test_mutations_are_refused_without_a_crash_a_hang_or_a_silent_accept() -> None:
    line = [sys.executable, str(SCRIPT), "--seconds", "30", "--count", "100000", "--json"]
    done = subprocess.run(line, capture_output=True, text=True)
    tally = json.loads(done.stdout)
    assert done.returncode == 0, done.stderr
    assert tally["executions"] > 1000
    assert tally["crashes"] == tally["hangs"] == tally["silent_accepts"] == 0
    assert tally["refused"] + tally["accepted_forged"] == tally["executions"]
