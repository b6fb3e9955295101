"""A part of benchmarks/robust/doors.py in every test run; files of gigabytes are in that alone."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SECONDS = 5.0
"""For all doors of one process."""
DOORS = (
    ("record", "photo-store", "suite"),
    ("checkpoint-full", "checkpoint-levels"),
    ("ply", "packed-ply", "spz", "sog", "lod-meta"),
    ("transforms", "colmap-text", "colmap-binary"),
)


@pytest.mark.parametrize("doors", DOORS, ids=lambda doors: doors[0])
def test_spoilt_inputs_end_in_a_result_or_in_one_line(doors: tuple[str, ...]) -> None:
    line = [sys.executable, "-m", "benchmarks.robust.doors", "--json", "--only", *doors]
    line += ["--seconds", str(SECONDS / len(doors)), "--no-sparse"]
    done = subprocess.run(line, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode in (0, 1), done.stderr
    found = json.loads(done.stdout)
    assert found.keys() == set(doors)
    for name, passed in found.items():
        assert not passed["trouble"], name
        assert passed["tried"] and not passed["outside"] and passed["growth_mib"] < 1024
