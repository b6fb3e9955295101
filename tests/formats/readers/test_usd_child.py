"""The process that reads USD: values into a file, or one line of what is wrong."""

import json
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gsynopsis.formats.readers import usd_child
from gsynopsis.formats.writers.usd import usd_bytes
from tests.formats.scattered import scattered

pytest.importorskip("pxr", reason="usd-core is not installed")

MEASURED = """
import resource, subprocess, sys
done = subprocess.run(sys.argv[1:], capture_output=True)
print(done.returncode, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


def child(monkeypatch: pytest.MonkeyPatch, source: Path, out: Path) -> int:
    """Its exit, in this process: which keeps its own limits."""
    monkeypatch.setattr(usd_child, "_limit", lambda size: None)
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


@pytest.mark.skipif(sys.platform != "linux", reason="memory is bounded on Linux alone")
@pytest.mark.parametrize("section", [b"TOKENS", b"FIELDS", b"PATHS"])
def test_a_count_that_no_file_has_takes_no_memory(section: bytes, tmp_path: Path) -> None:
    data = bytearray(usd_bytes(scattered(20, degree=1)))
    # The table of contents: names of 16 bytes, starts and sizes; sections begin with their count.
    (place,) = struct.unpack_from("<q", data, data.index(section.ljust(16, b"\0")) + 16)
    struct.pack_into("<Q", data, place, 300_000_000)
    path, out = tmp_path / "a.usdc", tmp_path / "a.npz"
    path.write_bytes(data)
    # Asked for by a small process: what is begun has the pages of who begins it for a moment.
    line = [sys.executable, "-m", "gsynopsis.formats.readers.usd_child", str(path), str(out)]
    told = subprocess.run([sys.executable, "-c", MEASURED, *line], capture_output=True, check=True)
    status, kilobytes = map(int, told.stdout.split()[-2:])
    assert status and not out.exists()
    assert kilobytes < 1 << 20
