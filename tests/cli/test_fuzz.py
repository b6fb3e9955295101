"""A part of benchmarks/robust/fuzz.py in every test run, in a process whose memory is capped."""

import json
import subprocess
import sys
from pathlib import Path

from benchmarks.viewer.node import NODE

ROOT = Path(__file__).parents[2]
MUTANTS, EVERY = 1000, 8


def test_every_command_and_both_decoders_have_the_same_verdict_of_a_mutant() -> None:
    line = [sys.executable, "-m", "benchmarks.robust.fuzz", "--count", str(MUTANTS)]
    line += ["--every", str(EVERY), "--json"]
    done = subprocess.run(line, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode in (0, 1), done.stderr
    tally = json.loads(done.stdout)
    assert not tally["trouble"]
    assert tally["mutants"] == MUTANTS
    assert tally["viewer"] == (MUTANTS if NODE else 0)
    assert tally["commands"] == 8 * MUTANTS / EVERY
    assert MUTANTS / 10 < tally["accepted"] < MUTANTS / 2
    assert tally["growth_mib"] < 512
