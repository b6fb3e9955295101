"""An import gives nested levels that come near the pictures of what was imported."""

from pathlib import Path

import numpy as np
import pytest

from gsynopsis.container import check_file
from gsynopsis.errors import InputError
from gsynopsis.formats.readers.base import LOGIT_MAX
from gsynopsis.jobs.import_splats import import_splats
from tests.formats.readers.test_any import ply


@pytest.fixture
def scene(rng: np.random.Generator, tmp_path: Path) -> Path:
    values = rng.standard_normal((400, 23)).astype(np.float32)
    values[:, 16:19] = -2 + 0.2 * values[:, 16:19]
    values[:, 15] = np.clip(3 * values[:, 15], -LOGIT_MAX, LOGIT_MAX)
    values[:, 6:15] *= 0.02  # noise, which no codebook of a small file holds
    return ply(tmp_path, values, "binary_little_endian")


@pytest.mark.slow
def test_levels_are_nested_and_better_with_every_one(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.gsyn"
    made = import_splats(scene, out, 3)
    levels = check_file(out)
    assert levels.shared.degree == 1
    assert made.splats == tuple(level.anchors for level in levels.levels) == (16, 80, 400)
    assert list(made.psnr) == sorted(made.psnr)
    assert made.psnr[-1] > 35
    assert {"first", "orbit", "up", "protocol"} <= set(levels.meta)


def test_a_file_that_is_there_stays(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.gsyn"
    out.write_bytes(b"mine")
    with pytest.raises(InputError, match="--overwrite"):
        import_splats(scene, out)
    assert out.read_bytes() == b"mine"


def test_a_draft_has_all_splats_and_levels_but_no_figures(scene: Path, tmp_path: Path) -> None:
    made = import_splats(scene, tmp_path / "draft.gsyn", 3, draft=True)
    levels = check_file(tmp_path / "draft.gsyn")
    assert made.splats == tuple(level.anchors for level in levels.levels) == (16, 80, 400)
    assert made.psnr == () and made.sheet is None
    assert "first" in levels.meta and levels.meta["protocol"] == "not measured: a draft"
    assert {path.name for path in tmp_path.glob("draft*")} == {"draft.gsyn"}
