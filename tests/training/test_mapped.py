"""Tensors of rows in files: what they hold, which pages they count, what the system gets back."""

from pathlib import Path

import numpy as np
import pytest
import torch

from gsynopsis.errors import SpaceError
from gsynopsis.training import mapped
from gsynopsis.training.mapped import PAGE, MappedRows

STATUS = Path("/proc/self/status")


def resident_files() -> int:
    """Bytes of files that are mapped into this process and in its memory."""
    found = [line for line in STATUS.read_text().splitlines() if line.startswith("RssFile:")]
    return int(found[0].split()[1]) * 1024


def test_rows_stay_go_and_come_as_by_indexing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mapped, "CHUNK", 7)
    files = MappedRows(tmp_path, budget=PAGE)
    values, new = torch.randn(40, 3, 5), torch.randn(4, 3, 5)
    keep = torch.rand(40) > 0.5
    made = files.copied(values, keep.nonzero()[:, 0], new)
    assert torch.equal(made, torch.cat([values[keep], new]))
    assert torch.equal(files.copied(values), values)
    assert files.copied(values[:0]).shape == (0, 3, 5) and files.zeros((3, 0)).shape == (3, 0)
    assert float(files.zeros((9, 2)).abs().max()) == 0 and not list(tmp_path.iterdir())


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("width", [1, 30, 1024, 3000])
def test_each_page_of_the_rows_counts_once(width: int, seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    rows = np.unique(rng.integers(0, 5000, 300))
    files, counted = MappedRows(tmp_path, budget=PAGE), list[int]()
    files.touched = counted.append  # type: ignore[method-assign]
    files.read(rows, [width])
    pages: set[int] = set()
    for row in rows.tolist():
        pages.update(range(4 * width * row // PAGE, (4 * width * (row + 1) - 1) // PAGE + 1))
    assert counted == [PAGE * len(pages)]


@pytest.mark.skipif(not STATUS.exists(), reason="no /proc to read memory from")
def test_pages_beyond_the_budget_leave_memory_and_keep_their_values(tmp_path: Path) -> None:
    files = MappedRows(tmp_path, budget=1 << 30)
    rows = files.zeros((1 << 14, 1024))  # 64 MiB
    before = resident_files()
    rows += 1
    assert resident_files() - before > 60 << 20
    files.touched(files.budget + 1)
    assert resident_files() - before < 8 << 20
    assert float(rows.sum()) == rows.numel()


def test_a_folder_that_cannot_hold_them_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(SpaceError, match="rows"):
        MappedRows(tmp_path / "missing", budget=1).zeros((4, 4))
