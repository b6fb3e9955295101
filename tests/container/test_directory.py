"""Every field of a directory's record, broken one at a time with all checksums right."""

import numpy as np
import pytest

from benchmarks.robust.forge import counted_for_sisters, taken, with_record
from gsynopsis.container import decode, layout
from gsynopsis.container.layout import BlockEntry
from gsynopsis.container.writer import encode_with_account
from gsynopsis.errors import ChecksumError, FormatError, LayoutError, ValueRangeError
from tests.level_sets import Shape, make_level_set

SHAPE = Shape(anchors=(20, 50, 110), slots=3, grids=(1, 1, 2))
DATA = encode_with_account(make_level_set(np.random.default_rng(4), SHAPE), block=16)[0]
RECORDS = taken(DATA).records
U32 = 2**32 - 1

BREAKS: dict[str, tuple[type[FormatError], list[float]]] = {
    "stored": (LayoutError, [0, 1, 2**27, U32]),
    "raw": (LayoutError, [0, 1, 2**27, U32]),
    "crc": (ChecksumError, [0, U32]),
    "parent": (LayoutError, [7, 65535, U32]),
    "live": (LayoutError, [0, 1, U32]),
    "before": (LayoutError, [1, 999, U32]),
    "low_x": (LayoutError, [2**31 - 1]),
    "low_y": (LayoutError, [2**31 - 1]),
    "low_z": (LayoutError, [2**31 - 1]),
    "high_x": (LayoutError, [-(2**31)]),
    "high_y": (LayoutError, [-(2**31)]),
    "high_z": (LayoutError, [-(2**31)]),
    "reach": (ValueRangeError, [-1.0, np.nan, np.inf]),
    "width": (LayoutError, [0, 7, 9, U32]),
}


def test_the_table_breaks_every_field() -> None:
    assert tuple(BREAKS) == BlockEntry._fields
    assert min(len(records) for records in RECORDS.values()) > 1


@pytest.mark.parametrize("level", RECORDS)
@pytest.mark.parametrize("name", BREAKS)
def test_a_broken_field_is_refused(name: str, level: int) -> None:
    expected, values = BREAKS[name]
    for value in values:
        with pytest.raises(expected) as caught:
            decode(with_record(DATA, level, 1, **{name: value}), "a.gsyn")
        assert type(caught.value) is expected, value
        assert f"level {level}" in str(caught.value), value


def changed(level: int, first: dict[str, int], second: dict[str, int]) -> bytes:
    """Two blocks' fields moved by opposite amounts, so that sums stay."""
    pieces = taken(DATA)
    for block, by in ((0, first), (1, second)):
        for name, step in by.items():
            pieces.records[level][name][block] += np.array(step).astype(
                pieces.records[level][name].dtype
            )
    return pieces.data()


def test_counts_that_only_sum_up_are_refused() -> None:
    for level in RECORDS:
        for name in ("live", "stored", "raw"):
            with pytest.raises(FormatError):
                decode(changed(level, {name: 1}, {name: U32}), "x")
    with pytest.raises(FormatError):
        decode(changed(2, {"before": 1}, {"before": U32}), "x")


def test_live_slots_of_the_level_before_are_those_that_it_showed() -> None:
    refusals: list[str] = []
    for data in counted_for_sisters(DATA, 2):
        with pytest.raises(LayoutError) as caught:
            decode(data, "x")
        refusals.append(str(caught.value))
    kept = [text for text in refusals if "live slots at level 1, expected" in text]
    assert kept, "no forgery got as far as the masks"


def test_rows_are_those_of_the_parents() -> None:
    pieces = taken(DATA)
    records = pieces.records[2]
    other = int(np.flatnonzero(records["parent"] != records["parent"][0])[0])
    for column in (0, 1):
        pieces = taken(DATA)
        pieces.records[2]["rows"][0, column] += 1
        pieces.records[2]["rows"][other, column] -= 1
        with pytest.raises(LayoutError, match="level 2 directory"):
            decode(pieces.data(), "x")


def test_parents_are_in_order_and_have_children() -> None:
    for link in ([0, 0], [1, 0], [5, 5]):
        pieces = taken(DATA)
        pieces.records[1]["parent"][-2:] = link
        with pytest.raises(LayoutError):
            decode(pieces.data(), "x")


def test_a_block_of_too_many_anchors_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    most = max(int(r["rows"].sum(axis=1).max()) for r in RECORDS.values())
    monkeypatch.setattr(layout, "BLOCK_ROWS_MAX", most - 1)
    with pytest.raises(LayoutError, match=f"at most {most - 1} anchors"):
        decode(DATA, "x")


def test_directories_stand_at_the_front_only_while_all_fits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    levels = make_level_set(np.random.default_rng(4), SHAPE)
    front, account = encode_with_account(levels, block=16)
    head = taken(front).header.head
    assert taken(front).header.front == 1
    monkeypatch.setattr(layout, "INDEX_BYTES_MAX", head - 1)
    later, other = encode_with_account(levels, block=16)
    assert taken(later).header.front == 0
    assert (len(front), account.total) == (len(later), other.total)
    whole = decode(front, "x")
    ends = [level.end for level in taken(later).levels]
    assert (decode(later, "x").shared.offsets == whole.shared.offsets).all()
    assert decode(later[: ends[0]], "x").levels[0].anchors == 20
