import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from gsynopsis.container import describe, write_gsyn
from gsynopsis.errors import ChecksumError, FormatError, InputError, TruncatedError
from gsynopsis.records import LevelSet
from tests.level_sets import ALL_SHAPES, BOTH, make_level_set


@pytest.fixture
def levels(rng: np.random.Generator) -> LevelSet:
    return make_level_set(rng, BOTH)


@pytest.mark.parametrize("coding", ["raw", "compact"])
@pytest.mark.parametrize("name", ALL_SHAPES)
def test_a_description_says_what_the_writer_accounted(
    name: str, coding: str, rng: np.random.Generator, tmp_path: Path
) -> None:
    levels = make_level_set(rng, ALL_SHAPES[name])
    account = write_gsyn(levels, tmp_path / "a.gsyn", coding)
    info = describe(tmp_path / "a.gsyn")
    assert (info.bytes, info.index_bytes) == (account.total, account.index)
    assert info.levels_total == len(info.levels) == len(levels.levels)
    assert info.slots_per_anchor == levels.shared.slots
    assert info.stand_ins == levels.shared.stand_ins
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


@pytest.mark.parametrize("coding", ["raw", "compact"])
def test_each_part_has_the_coding_and_nearly_the_bytes_of_the_account(
    levels: LevelSet, coding: str, tmp_path: Path
) -> None:
    account = write_gsyn(levels, tmp_path / "a.gsyn", coding)
    info = describe(tmp_path / "a.gsyn")
    said = {(v.level, p.kind): p for v in info.levels for p in v.parts}
    for part in account.parts:
        if part.kind not in ("grid", "directory"):
            found = said[part.level, part.kind]
            assert (found.coding, found.raw) == (part.coding, part.raw)
            assert abs(found.stored - part.stored) <= 12
    codings = {part.coding for part in said.values()} - {""}
    assert codings == ({"float"} if coding == "raw" else {"affine8", "curve8"})


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
    with pytest.raises(ChecksumError, match="manifest"):
        describe(path)
    for length in range(0, first + 1, 7):
        path.write_bytes(data[:length])
        with pytest.raises(FormatError):
            describe(path)


def describe_offset(data: bytes) -> int:
    """Where the manifest begins: after 88 bytes, 48 per level and 40 per chunk."""
    levels, chunks = np.frombuffer(data[16:20], "<u2").tolist()
    return 88 + 48 * levels + 40 * chunks
