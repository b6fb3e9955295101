"""The summary of a run: what it left out for want of a browser is counted at its end."""

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.bench import ROOT

TESTS = """
import pytest

@pytest.mark.parametrize("number", range({count}))
@pytest.mark.skipif(True, reason="no Chromium: viewer NOT tested in a browser")
def test_of_the_page(number): ...

@pytest.mark.skipif(True, reason="no ffmpeg: video NOT tested")
def test_of_a_video(): ...

def test_of_nothing_special(): ...
"""


@pytest.mark.parametrize(("workers", "count"), [(0, 0), (0, 3), (2, 3)])
def test_the_last_line_counts_tests_that_had_no_browser(
    workers: int, count: int, tmp_path: Path
) -> None:
    path = tmp_path / "test_some.py"
    path.write_text(TESTS.format(count=count) if count else "def test_of_nothing_special(): ...")
    words = ["-p", "tests.conftest", "-p", "no:cacheprovider", "-n", str(workers), str(path)]
    command = [sys.executable, "-m", "pytest", "-c", str(ROOT / "pyproject.toml"), *words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    last = done.stdout.splitlines()[-1]
    if count:
        assert last == "3 tests in a browser were skipped: see the reasons above"
    else:
        assert "1 passed" in last
