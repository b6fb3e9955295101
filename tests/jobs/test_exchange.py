"""Whatever comes in, the crown of the tree is up in every format that goes out."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from gsynopsis.container import read_gsyn, write_gsyn
from gsynopsis.formats.axes import parse_up
from gsynopsis.formats.readers.any import read_splats
from gsynopsis.formats.readers.base import SplatFile
from gsynopsis.jobs import export as exporting
from gsynopsis.jobs import import_splats as importing
from gsynopsis.jobs.export import ENDINGS, Exporting, Format, export
from gsynopsis.model.splat_levels import splat_levels
from gsynopsis.model.splats import plain_level
from gsynopsis.runs.folder import find_run
from tests.formats.trees import HEIGHT, crown_of, shown_world, tree, write_tree

pytest.importorskip("gaussforge", reason="gaussforge is not installed: no SPZ")
pytest.importorskip("pxr", reason="usd-core is not installed: no USD")
pytestmark = pytest.mark.usefixtures("few_tries")

KINDS = (
    *("ply", "ply-z", "ply-oblique", "compressed-ply", "splat", "ksplat", "glb", "usd"),
    *("spz2", "spz4", "sog", "ssog", "ssog-zip"),
)
FORMATS = tuple(ENDINGS)
UPS: dict[Format, list[float]] = {"spz": [0, 1, 0], "spz3": [0, 1, 0]}
"""Of the values in files; else that of 3DGS."""


def check_crown(path: Path, name: Format) -> None:
    """The crown is where the format has up, on the same corner of the lawn, and is seen upright."""
    if name in ("glb", "usd"):
        points, sh = shown_world(path, name)
        up = np.array([0.0, 1.0, 0.0])
    else:
        found = read_splats(path)
        (points, sh), up = (found.levels[-1].means, found.levels[-1].sh), np.array(found.up)
        assert up.tolist() == UPS.get(name, [0, -1, 0])
    crown = crown_of(points.astype(np.float64), sh)
    assert crown @ up == pytest.approx(HEIGHT, abs=0.05)
    assert np.linalg.norm(crown - HEIGHT * up) == pytest.approx(0.6 * 2**0.5, abs=0.1)


@pytest.fixture(scope="module")
def trees(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], SplatFile]:
    """The tree by the kind of its file, each read once for all formats: USD by a process."""
    return cache(lambda kind: read_splats(write_tree(tmp_path_factory.mktemp("in"), kind)))


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("kind", KINDS)
def test_the_crown_stays_up_from_reader_to_writer(
    kind: str, name: Format, trees: Callable[[str], SplatFile], tmp_path: Path
) -> None:
    given = trees(kind)
    finest = given.levels[-1]
    notes = {"up": " ".join(map(str, given.up))}
    levels = splat_levels(finest, np.ones(len(finest)), [len(finest)], notes)
    write_gsyn(levels, tmp_path / "a.gsyn")
    check_crown(_exported(tmp_path / "a.gsyn", name), name)


@pytest.mark.parametrize("kind", KINDS)
def test_the_crown_stays_up_by_import_and_export(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importing, "VIEWS_SIDE", 48)
    made = importing.import_splats(
        write_tree(tmp_path / "in", kind), tmp_path / "a.gsyn", 2, steps=2
    )
    levels = read_gsyn(made.path)
    assert parse_up(levels.meta["up"]) == pytest.approx(made.up, abs=1e-5)
    gaussians = plain_level(levels, -1)
    crown = crown_of(gaussians.means.astype(np.float64), gaussians.sh)
    assert crown @ np.array(made.up) == pytest.approx(HEIGHT, abs=0.05)
    for name in FORMATS:
        check_crown(_exported(made.path, name), name)


def _exported(file: Path, name: Format) -> Path:
    (made,) = export(find_run(file), file.parent / "out", Exporting(format=name), None)
    return made.path


def test_what_was_trained_keeps_the_world_of_its_poses_in_ply(rng: np.random.Generator) -> None:
    from tests.level_sets import make_level_set

    levels = make_level_set(rng)
    meta = levels.meta
    for up, name, turns in (
        ("0.1 -0.9 0.2", "spz", False),
        ("0.1 0.2 0.9", "ply", False),
        ("0.1 0.2 0.9", "usd", True),
        ("0.1 0.3 -0.9", "glb", True),
    ):
        object.__setattr__(levels, "meta", {**meta, "up": up})
        baked = exporting.in_axes(exporting.Baked(0, tree(), None), levels, name)
        assert bool(baked.note) == turns
        assert np.array_equal(baked.gaussians.means, tree().means) != turns
