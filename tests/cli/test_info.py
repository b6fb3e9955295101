"""What `gsynopsis info` says of a file."""

from pathlib import Path

import numpy as np
import pytest

from gsynopsis import cli
from gsynopsis.container import write_gsyn
from tests.level_sets import SPLATS, STAND_INS, make_level_set


def said_of(path: Path, capsys: pytest.CaptureFixture[str]) -> str:
    assert cli.main(["info", str(path)]) == 0
    return capsys.readouterr().out


def test_stand_ins_are_said_of_a_file_and_of_a_prefix(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.gsyn"
    account = write_gsyn(make_level_set(rng, STAND_INS), path)
    line = f"{STAND_INS.anchors[1]} splats are stand-ins: level 2 and finer drop them"
    assert line in said_of(path, capsys)
    path.write_bytes(path.read_bytes()[: account.ends[1]])
    assert "all splats are stand-ins, until level 2 comes" in said_of(path, capsys)
    write_gsyn(make_level_set(rng, SPLATS), path)
    assert "stand-ins" not in said_of(path, capsys)
