"""A file in hand: facts, levels, cuts, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from gsynopsis.container import decode, encode
from gsynopsis.errors import FormatError, InputError
from gsynopsis.runs.gsyn_file import Splats, open_source
from tests.level_sets import Shape, assert_same, make_level_set

LARGE = Shape(anchors=(40, 200, 800, 3000))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "scene.gsyn"
    path.write_bytes(encode(make_level_set(np.random.default_rng(0), LARGE), "compact"))
    return path


def test_facts_of_levels_are_those_of_the_file(path: Path) -> None:
    levels = decode(path.read_bytes(), "scene").levels
    with open_source(path) as file:
        assert [fact.anchors for fact in file.levels] == [level.anchors for level in levels]
        assert [fact.slots for fact in file.levels] == [level.live for level in levels]
        assert file.levels[-1].bytes == path.stat().st_size
        assert sum(fact.delta for fact in file.levels) == file.levels[-1].bytes
        assert_same(file.level_set(), decode(path.read_bytes(), "scene"))


def test_a_coarse_level_costs_its_prefix_only(path: Path) -> None:
    with open_source(path) as file:
        assert len(file.level_set(0).levels) == 1
        read = file.bytes_read
        assert read < 0.5 * path.stat().st_size
        file.level_set()
        assert file.bytes_read == path.stat().st_size > read


def test_a_level_cut_off_is_a_file_of_its_own(path: Path, tmp_path: Path) -> None:
    with open_source(path) as file:
        part = file.cut(tmp_path / "part.gsyn", 1)
        length = file.levels[1].bytes
    assert part.read_bytes() == path.read_bytes()[:length]
    with open_source(part) as file:
        assert len(file.levels) == 2


@pytest.mark.parametrize("level", [4, -5])
def test_a_level_that_is_not_there_is_refused(path: Path, level: int) -> None:
    with open_source(path) as file, pytest.raises(InputError, match="0 to 3"):
        file.level_set(level)


def test_what_is_no_file_and_what_is_no_gsyn_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        open_source(tmp_path / "absent.gsyn")
    (tmp_path / "other.gsyn").write_bytes(b"PNG" * 4000)
    with pytest.raises(FormatError):
        open_source(tmp_path / "other.gsyn")


def test_splats_are_shown_by_their_number() -> None:
    values = [np.zeros((7, width), np.float32) for width in (3, 3, 4, 3)]
    splats = Splats(*values[:3], np.zeros(7, np.float32), values[3])
    assert len(splats) == 7 and repr(splats).startswith("Splats(7 Gaussians: ")
