"""Tiny scenes on disk, made to be broken."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsynopsis.scene.colmap.binary import write_binary
from gsynopsis.synthetic.make_scene import make_scene
from tests.scene.tiny_models import SIZE, tiny_model


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
def small_room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The procedural room at 96 × 64 pixels, 10 views."""
    out = tmp_path_factory.mktemp("room") / "room"
    return make_scene("room", out, views=10, width=96, height=64, points=500)


@pytest.fixture(scope="session")
def small_garden(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The procedural garden at 96 × 64 pixels, 10 views."""
    out = tmp_path_factory.mktemp("garden") / "garden"
    return make_scene("outdoor", out, views=10, width=96, height=64, points=500)
