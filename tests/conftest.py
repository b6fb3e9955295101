"""Seeds, threads and the real scenes, for all tests."""

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import settings
from PIL import Image

from gsynopsis.errors import GsynopsisError
from gsynopsis.scene.colmap.binary import write_binary
from gsynopsis.synthetic.make_scene import make_scene
from tests.scene.tiny_models import SIZE, tiny_model

if TYPE_CHECKING:
    from gsynopsis.render.webgpu.renderer import WebGpuRenderer

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


@pytest.fixture(scope="module")
def few_tries() -> Iterator[None]:
    """Cameras of splats, and up, are found among few: for tests that do not look at which are best.

    Of at most 56 small pictures rather than 656, and 17 rather than 96 for each direction that may
    be up.
    """
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {"TURNS": 4, "TRIED": 24, "AGAIN": (), "QUICK": 6}.items():
            patch.setattr(f"gsynopsis.cameras.found.{name}", value)
        yield


@pytest.fixture
def real_scene():
    """Path of a real scene by name, or a skip that says what is missing."""

    def find(name: str) -> Path:
        if not (DATA / name / "sparse" / "0").is_dir():
            pytest.skip(f"real scene '{name}' is not there: set GSYNOPSIS_DATA to its folder")
        return DATA / name

    return find


@pytest.fixture
def tiny(tmp_path: Path) -> Callable[..., Path]:
    """Writes a COLMAP scene of random photos and returns its folder."""

    def make(names: Sequence[str] = ("b.png", "a.png", "c.png"), points: int = 7) -> Path:
        root = tmp_path / "tiny"
        write_binary(root / "sparse" / "0", tiny_model(names, points))
        rng = np.random.default_rng(4)
        (root / "images").mkdir(exist_ok=True)
        for name in names:
            path = root / "images" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            pixels = rng.integers(0, 256, (SIZE[1], SIZE[0], 3)).astype(np.uint8)
            Image.fromarray(pixels).save(path)
        return root

    return make


@pytest.fixture(scope="session")
def webgpu() -> "WebGpuRenderer":
    """The first adapter, which may be a software driver; without one, a skip that says so."""
    # Not at the top: it imports torch, and some tests start processes that have these fixtures.
    from gsynopsis.render.webgpu.renderer import WebGpuRenderer

    os.environ.setdefault("LP_NUM_THREADS", "1")
    try:
        return WebGpuRenderer()
    except GsynopsisError as error:
        missing = "a test of WebGPU kernels needs a Vulkan driver (Debian: mesa-vulkan-drivers)"
        pytest.skip(f"{missing}, tests of WebGPU kernels are left out: {error}")


@pytest.fixture(scope="session")
def small_room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The procedural room at 96 × 64 pixels, 10 views."""
    out = tmp_path_factory.mktemp("room") / "room"
    return make_scene("room", out, views=10, width=96, height=64, points=500)


@pytest.fixture(scope="session")
def small_garden(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The procedural garden at 96 × 64 pixels, 10 views."""
    out = tmp_path_factory.mktemp("garden") / "garden"
    return make_scene("outdoor", out, views=10, width=96, height=64, points=500)


def pytest_unconfigure(config: pytest.Config) -> None:
    """The last lines of a run without a browser or a Vulkan driver: how many tests it left out."""
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    skipped = reporter.stats.get("skipped", []) if reporter else []
    for what in ("in a browser", "of WebGPU kernels"):
        count = sum(what in str(report.longrepr) for report in skipped)
        if reporter and count:
            reporter.write_line(f"{count} tests {what} were skipped: see the reasons above")
