"""A part of benchmarks/robust/ways.py in every test run: each layout and each fault once."""

from pathlib import Path

import pytest

from benchmarks.robust.ways import FAULTS, LAYOUTS, make, verdict

COUNT = max(len(FAULTS), len(LAYOUTS))


@pytest.mark.parametrize("number", range(COUNT))
def test_a_mixture_loads_as_it_should_or_ends_in_one_line(number: int, tmp_path: Path) -> None:
    root = tmp_path / "scene"
    root.mkdir()
    what, mixture = make(number, root)
    assert not verdict(mixture, root), what
