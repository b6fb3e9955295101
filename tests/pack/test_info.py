import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from gsynopsis.errors import ChecksumError, FormatError, InputError, TruncatedError
from gsynopsis.pack import describe, write_gsyn
from gsynopsis.records import LevelSet
from tests.level_sets import BOTH, SHAPES, make_level_set


@pytest.fixture
def levels(rng: np.random.Generator) -> LevelSet:
    return make_level_set(rng, BOTH)


@pytest.mark.parametrize("coding", ["raw", "compact"])
@pytest.mark.parametrize("name", SHAPES)
def test_a_description_says_what_the_writer_accounted(
    name: str, coding: str, rng: np.random.Generator, tmp_path: Path
) -> None:
    levels = make_level_set(rng, SHAPES[name])
    account = write_gsyn(levels, tmp_path / "a.gsyn", coding)
    info = describe(tmp_path / "a.gsyn")
    assert (info.bytes, info.index_bytes, info.coding) == (account.total, account.index, coding)
    assert info.levels_total == len(info.levels) == len(levels.levels)
    assert info.slots_per_anchor == levels.shared.slots
    assert info.meta == {"scene": "random", "generator": "tests"}
    for k, (said, level) in enumerate(zip(info.levels, levels.levels, strict=True)):
        assert (said.anchors, said.slots, said.grids) == (level.anchors, level.live, level.grids)
        assert said.delta == account.delta(k)
        assert said.bytes == sum(account.delta(j) for j in range(k + 1))
        assert said.delta == sum(p.stored for p in said.parts) + (0 if k else info.index_bytes)
        assert said.quality == level.quality
    parts = [part for level in info.levels for part in level.parts]
    assert sum(part.values for part in parts) == sum(part.values for part in account.parts)


def test_a_description_is_ready_for_json(levels: LevelSet, tmp_path: Path) -> None:
    write_gsyn(levels, tmp_path / "a.gsyn")
    info = asdict(describe(tmp_path / "a.gsyn"))
    assert json.loads(json.dumps(info))["levels"][0]["parts"][0]["kind"] == "manifest"


def test_a_prefix_says_how_much_of_the_scene_it_is(levels: LevelSet, tmp_path: Path) -> None:
    path = tmp_path / "a.gsyn"
    write_gsyn(levels, path)
    end = describe(path).levels[1].bytes
    path.write_bytes(path.read_bytes()[:end])
    info = describe(path)
    assert (info.bytes, info.levels_total, len(info.levels)) == (end, 4, 2)


def test_a_value_beyond_half_precision_shows_in_the_coding(
    levels: LevelSet, tmp_path: Path
) -> None:
    levels.shared.grids[1][0, 0] = 1e9
    levels.shared.grids[2][0, 0] = 1e9
    write_gsyn(levels, tmp_path / "a.gsyn")
    codings = [
        part.coding
        for level in describe(tmp_path / "a.gsyn").levels
        for part in level.parts
        if part.kind == "grid"
    ]
    assert codings == ["half", "shuffle", "shuffle"]


def test_a_damaged_or_missing_file_is_refused(levels: LevelSet, tmp_path: Path) -> None:
    path = tmp_path / "a.gsyn"
    with pytest.raises(InputError, match="expected a readable"):
        describe(path)
    write_gsyn(levels, path)
    data = path.read_bytes()
    path.write_bytes(data[:-1])
    with pytest.raises(TruncatedError, match="expected the end of a level"):
        describe(path)
    first = describe_offset(data)
    path.write_bytes(data[:first] + bytes([data[first] ^ 1]) + data[first + 1 :])
    with pytest.raises(ChecksumError, match="level 0 manifest"):
        describe(path)
    for length in range(0, first + 1, 7):
        path.write_bytes(data[:length])
        with pytest.raises(FormatError):
            describe(path)


def describe_offset(data: bytes) -> int:
    """Where the manifest begins: after 80 bytes, 40 per level and 48 per chunk."""
    levels, chunks = np.frombuffer(data[16:20], "<u2").tolist()
    return 80 + 40 * levels + 48 * chunks
