"""An import gives nested levels that come near the pictures of what was imported."""

from pathlib import Path

import numpy as np
import pytest

from gsynopsis.container import check_file
from gsynopsis.errors import InputError, SettingError
from gsynopsis.formats.readers.any import read_splats
from gsynopsis.formats.readers.base import LOGIT_MAX
from gsynopsis.jobs.import_splats import (
    COPIES,
    MEMORY,
    MEMORY_EACH,
    STAND_INS_MOST,
    import_splats,
    memory_needed,
    most_showing,
    splat_model,
    stand_in_counts,
)
from tests.formats.readers.test_any import ply

# Levels are looked at, not from where they are: tests of `cameras` do that.
pytestmark = pytest.mark.usefixtures("few_tries")


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """What takes long is pictures: theirs are a quarter as wide."""
    monkeypatch.setattr("gsynopsis.jobs.import_splats.VIEWS_SIDE", 120)


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
    made = import_splats(scene, out, 3, steps=0)
    levels = check_file(out)
    assert levels.shared.degree == 1 and not levels.shared.stand_ins
    assert made.splats == tuple(level.anchors for level in levels.levels) == (16, 80, 400)
    assert list(made.psnr) == sorted(made.psnr)
    assert made.psnr[-1] > 35
    assert {"first", "orbit", "up", "protocol"} <= set(levels.meta)


@pytest.mark.slow
def test_trained_stand_ins_show_more_than_as_many_of_the_splats(
    scene: Path, tmp_path: Path
) -> None:
    out = tmp_path / "a.gsyn"
    # Two levels of an import without training: as many splats in the coarser one, or more.
    plain = import_splats(scene, tmp_path / "plain.gsyn", 2, steps=0)
    made = import_splats(scene, out, 3, steps=60)
    levels = check_file(out)
    assert levels.shared.stand_ins == 2
    assert made.splats == (8, 60, 400)
    assert [level.anchors for level in levels.levels] == [8, 60, 460]
    assert [levels.first_shown(level) for level in range(3)] == [0, 0, 60]
    assert plain.splats[0] <= 60 and made.psnr[1] > plain.psnr[0] + 1
    assert list(made.psnr) == sorted(made.psnr)
    assert made.psnr[-1] == pytest.approx(plain.psnr[-1], abs=0.2)
    # Small images thicken stand-ins as they thicken the input, which is not anti-aliased.
    assert "focals" not in levels.meta
    own, whole = (levels.levels[k].codebook.size for k in (0, 2))
    assert not own and whole
    again = import_splats(scene, tmp_path / "again.gsyn", 3, steps=60)
    assert (tmp_path / "again.gsyn").read_bytes() == out.read_bytes()
    assert again.psnr == made.psnr


@pytest.mark.slow
def test_the_half_that_shows_most_comes_before_the_whole(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.gsyn"
    made = import_splats(scene, out, 4, steps=60)
    levels = check_file(out)
    assert levels.shared.stand_ins == 2
    assert made.splats == (8, 60, 200, 400)
    assert [levels.first_shown(level) for level in range(4)] == [0, 0, 60, 60]
    assert list(made.psnr) == sorted(made.psnr)
    # The half is of the input itself: its rows are those of the same file without stand-ins.
    plain = import_splats(scene, tmp_path / "plain.gsyn", 1, steps=0)
    assert made.psnr[-1] == pytest.approx(plain.psnr[-1], abs=0.2)
    ends = np.diff((0, *made.ends))
    assert ends[2] < 0.6 * (ends[2] + ends[3]), "each splat is sent once"


@pytest.mark.slow
def test_the_quarter_that_shows_most_is_a_level_where_it_shows_more(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Of scattered splats a quarter shows little more than the stand-ins.
    fewer = import_splats(scene, tmp_path / "a.gsyn", 5, steps=60)
    assert fewer.splats == (8, 60, 200, 400)
    (line,) = [note for note in fewer.notes if note.startswith("no level of")]
    assert line.startswith("no level of the 100 splats that show most: they have ")
    monkeypatch.setattr("gsynopsis.jobs.import_splats.PAYS", -10.0)
    made = import_splats(scene, tmp_path / "b.gsyn", 5, steps=60)
    assert made.splats == (8, 60, 100, 200, 400)
    assert not [note for note in made.notes if note.startswith("no level of")]
    assert made.psnr[:2] == fewer.psnr[:2] and made.psnr[-1] == pytest.approx(fewer.psnr[-1], 0.01)


def test_what_shows_most_is_drawn_in_place_of_all(scene: Path) -> None:
    truth = splat_model(read_splats(scene))
    worth = np.arange(400.0)
    drawn = most_showing(truth, worth).mask[:, 0].nonzero()[:, 0]
    assert drawn.tolist() == list(range(400 - 283, 400))


@pytest.mark.parametrize("total", [1, 2, 3, 30, 12_000_000])
@pytest.mark.parametrize("levels", [1, 2, 7])
def test_stand_ins_are_few_of_many_and_bounded(total: int, levels: int) -> None:
    counts = stand_in_counts(total, levels)
    assert len(counts) == levels and counts == sorted(counts)
    assert counts[0] >= 1 and counts[-1] <= max(1, 0.15 * total + 1)
    assert counts[-1] <= STAND_INS_MOST


def test_levels_that_would_have_no_splats_of_their_own_are_said(tmp_path: Path) -> None:
    values = np.zeros((2, 23), np.float32)
    values[:, 0], values[:, 15:19], values[:, 19] = (-1, 1), (2, -2, -2, -2), 1
    made = import_splats(ply(tmp_path, values, "ascii"), tmp_path / "a.gsyn", steps=2)
    assert made.splats == (1, 2)
    assert any(note.startswith("2 of 6 levels") for note in made.notes)


@pytest.mark.parametrize("steps", [-1, 10**9])
def test_steps_out_of_bounds_are_refused(steps: int, tmp_path: Path) -> None:
    with pytest.raises(SettingError, match="--steps"):
        import_splats(tmp_path / "x.ply", tmp_path / "a.gsyn", steps=steps)


def test_much_memory_is_said_before_it_is_taken(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    monkeypatch.setattr("gsynopsis.jobs.import_splats.MEMORY_EACH", (3 << 30) / 400)

    def tick(what: str, done: int, total: int) -> None:
        said.append(what)

    import_splats(scene, tmp_path / "a.gsyn", 1, steps=0, tick=tick)
    assert said.index("400 splats, about 3.3 GiB of memory") < said.index("finding cameras")
    few = read_splats(scene)
    monkeypatch.undo()
    assert memory_needed(few) < 1 << 30
    assert memory_needed(few) - MEMORY == 400 * (MEMORY_EACH + COPIES * 9 * 4)


def test_coarser_levels_of_a_family_are_not_used_and_that_is_said(
    rng: np.random.Generator, tmp_path: Path
) -> None:
    for number, count in enumerate((300, 60)):
        values = rng.standard_normal((count, 23)).astype(np.float32)
        values[:, 15:19] -= 2
        file = ply(tmp_path, values, "binary_little_endian")
        file.rename(tmp_path / f"b_lod{number}.ply")
    made = import_splats(tmp_path / "b_lod0.ply", tmp_path / "b.gsyn", 3, steps=2)
    assert made.splats[-1] == 300 and len(made.splats) == 3
    assert sum("not used" in note for note in made.notes) == 1


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
