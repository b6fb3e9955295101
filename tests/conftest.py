"""Seeds, threads and the real scenes, for all tests."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

# The same examples each time, and no deadline: tests never assert on time.
settings.register_profile("house", deadline=None, derandomize=True)
settings.load_profile("house")

DATA = Path(os.environ.get("GSYNOPSIS_DATA", Path(__file__).parents[2] / "shared" / "data"))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20261121)


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Children that begin meanwhile heed SIGINT; else they ignore it where pytest does (nohup)."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def real_scene():
    """Path of a real scene by name, or a skip that says what is missing."""

    def find(name: str) -> Path:
        if not (DATA / name / "sparse" / "0").is_dir():
            pytest.skip(f"real scene '{name}' is not there: set GSYNOPSIS_DATA to its folder")
        return DATA / name

    return find


def pytest_unconfigure(config: pytest.Config) -> None:
    """The last line of a run without a browser: the number of tests that it left out for it."""
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    skipped = reporter.stats.get("skipped", []) if reporter else []
    count = sum("in a browser" in str(report.longrepr) for report in skipped)
    if reporter and count:
        reporter.write_line(f"{count} tests in a browser were skipped: see the reasons above")
