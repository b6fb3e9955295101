"""The process that reads USD: values into a file, or one line of what is wrong."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from gsynopsis.formats.readers import usd_child
from gsynopsis.formats.writers.usd import usd_bytes
from tests.formats.scattered import scattered

pytest.importorskip("pxr", reason="usd-core is not installed")


def child(monkeypatch: pytest.MonkeyPatch, source: Path, out: Path) -> int:
    """Its exit, in this process: which keeps its own limit of time."""
    monkeypatch.setattr(usd_child, "_limit_processor", lambda size: None)
    monkeypatch.setattr(sys, "argv", ["usd_child", str(source), str(out)])
    return usd_child.main()


def test_values_and_up_are_written_for_the_parent(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    given = scattered(20, degree=1)
    (tmp_path / "a.usdc").write_bytes(usd_bytes(given))
    assert child(monkeypatch, tmp_path / "a.usdc", tmp_path / "a.npz") == 0
    with np.load(tmp_path / "a.npz") as found:
        assert found["up"].tolist() == [0, 1, 0] and found["means"].shape == (20, 3)
        assert np.allclose(found["log_scales"], given.log_scales, atol=1e-5)
        assert found["sh"].shape == (20, 4, 3)


def test_what_is_wrong_is_one_line_of_json_and_nothing_is_written(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.usdc").write_bytes(b"no layer at all")
    assert child(monkeypatch, tmp_path / "a.usdc", tmp_path / "a.npz") == 1
    said = json.loads(capsys.readouterr().out)
    assert said["expected"].startswith("USD with") and said["found"]
    assert not (tmp_path / "a.npz").exists()
