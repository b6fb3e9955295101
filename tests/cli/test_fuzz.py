"""A part of benchmarks/robust/fuzz.py in every test run, in processes whose memory is capped."""

import json
import sys
from pathlib import Path

import pytest

from benchmarks.robust import fuzz
from benchmarks.robust.fuzz import SHARE, Options, Tally, finished, shares_of
from benchmarks.viewer.node import NODE

MUTANTS, EVERY = 1000, 10


def test_every_command_and_both_decoders_have_the_same_verdict_of_a_mutant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "shares.jsonl"
    line = ["fuzz.py", "--count", str(MUTANTS), "--every", str(EVERY), "--jobs", "1"]
    # The mutants are read by a process of its own, whose memory is capped.
    monkeypatch.setattr(sys, "argv", [*line, "--log", str(log), "--json"])
    code = fuzz.main()
    tally = json.loads(capsys.readouterr().out)
    assert not tally["trouble"]
    assert tally["mutants"] == MUTANTS
    assert tally["viewer"] == (MUTANTS if NODE else 0)
    assert tally["commands"] == 9 * MUTANTS / EVERY
    assert MUTANTS / 10 < tally["accepted"] < MUTANTS / 2
    assert tally["growth_mib"] < 512
    # What the log has is counted and not run again.
    assert fuzz.main() == code
    assert json.loads(capsys.readouterr().out) == tally
    assert len(log.read_text().splitlines()) == MUTANTS / SHARE


def test_shares_make_up_the_mutants_and_a_log_is_of_one_seed(tmp_path: Path) -> None:
    shares = list(shares_of(Options(count=2 * SHARE + 1, first=7)))
    assert [(share.number, share.count) for share in shares] == [(7, SHARE), (8, SHARE), (9, 1)]
    log = tmp_path / "shares.jsonl"
    entry = json.dumps([vars(shares[0]), vars(Tally(mutants=SHARE))])
    log.write_text(f"{entry}\n{entry[:40]}")
    known = finished(log)
    assert known.keys() == {shares[0]}
    assert not known.keys() & set(shares_of(Options(seed=1, first=7)))


def test_troubles_of_shares_add_up_and_peaks_do_not() -> None:
    total = Tally(hangs=1, slowest_s=2.0, trouble=["a"])
    total.add(Tally(hangs=2, slowest_s=1.0, trouble=["b"] * 30))
    assert (total.failed, total.slowest_s, len(total.trouble)) == (3, 2.0, 20)
