from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.viewer.browser import one_browser
from gsynopsis.container import encode
from tests.viewer.bright import bright_levels


@pytest.fixture(scope="session")
def bright(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a scene whose levels look different."""
    path = tmp_path_factory.mktemp("scene") / "scene.gsyn"
    path.write_bytes(encode(bright_levels(), "compact"))
    return path


@pytest.fixture(scope="session", autouse=True)
def browser() -> Iterator[None]:
    """One browser for all visits of a worker; each has a context of its own."""
    with one_browser():
        yield
