"""Splats in coordinates of a map come back where they were."""

from pathlib import Path

import numpy as np
import pytest

from gsynopsis.container import read_gsyn
from gsynopsis.formats.readers.any import read_splats
from gsynopsis.formats.writers.ply import ply_bytes
from gsynopsis.jobs import import_splats as importing
from gsynopsis.jobs.export import Exporting, export
from gsynopsis.runs.folder import find_run
from tests.formats.trees import tree

UTM = (500_000.0, 30.0, 4_649_776.0)


def test_doubles_hold_the_shift(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    path.write_bytes(ply_bytes(tree(), shift=UTM))
    found = read_splats(path)
    places = found.levels[0].means.astype(np.float64) + found.shift
    assert np.allclose(places, tree().means.astype(np.float64) + UTM, atol=1e-6)


@pytest.mark.parametrize("up", [(0.0, -1.0, 0.0), (0.0, 0.0, 1.0)])
def test_what_was_imported_is_exported_where_it_was(
    up: tuple[float, float, float], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importing, "VIEWS_SIDE", 48)
    path = tmp_path / "a.ply"
    path.write_bytes(ply_bytes(tree(up), up=up, shift=UTM))
    made = importing.import_splats(path, tmp_path / "a.gsyn", 1, up=up)
    assert any("moved by minus" in note for note in made.notes)
    assert read_gsyn(made.path).meta["shift"].split()[0] == "500000"
    run = find_run(made.path)
    (out,) = export(run, tmp_path / "out", Exporting(format="ply"), None)
    again = read_splats(out.path)
    middle = (again.levels[0].means.astype(np.float64) + again.shift).mean(axis=0)
    wanted = tree(up).means.astype(np.float64).mean(axis=0) + UTM
    if up[2]:  # turned to the axes of 3DGS: z up is y down
        wanted = np.array([wanted[0], -wanted[2], wanted[1]])
    assert np.allclose(middle, wanted, atol=0.05)
    (out,) = export(run, tmp_path / "out", Exporting(format="glb"), None)
    assert any("positions are less by (" in note for note in out.notes)
