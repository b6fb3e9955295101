from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.viewer.browser import one_browser
from gsynopsis.container import encode
from tests.viewer.bright import FEW, bright_levels
from tests.viewer.room import write_room


@pytest.fixture(scope="session")
def bright(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a scene whose levels look different."""
    path = tmp_path_factory.mktemp("scene") / "scene.gsyn"
    path.write_bytes(encode(bright_levels(), "compact"))
    return path


@pytest.fixture(scope="session")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same with a tenth of the splats: for tests of all that is around the picture."""
    path = tmp_path_factory.mktemp("small") / "scene.gsyn"
    path.write_bytes(encode(bright_levels(FEW), "compact"))
    return path


@pytest.fixture(scope="session")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a room with walls and a pillar."""
    return write_room(tmp_path_factory.mktemp("room"))


@pytest.fixture(scope="session", autouse=True)
def browser() -> Iterator[None]:
    """One browser for all visits of a worker; each has a page of its own."""
    with one_browser():
        yield
