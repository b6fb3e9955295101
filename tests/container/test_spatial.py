import json
from dataclasses import replace

import numpy as np
import pytest

from gsynopsis.container import decode, layout
from gsynopsis.container.codecs import deflate
from gsynopsis.container.directory import pack_directory, record_type
from gsynopsis.container.index import Index, plan
from gsynopsis.container.layout import Header, LevelEntry
from gsynopsis.container.notes.first_view import parse_first
from gsynopsis.container.spatial import blocks_of_levels, sorted_levels
from gsynopsis.container.writer import encode_with_account
from tests.level_sets import ALL_SHAPES, Shape, make_level_set


@pytest.mark.parametrize("name", ALL_SHAPES)
@pytest.mark.parametrize("size", [2, 8, 10_000])
def test_blocks_divide_their_parents_and_hold_at_most_so_many(name: str, size: int) -> None:
    levels = sorted_levels(make_level_set(np.random.default_rng(6), ALL_SHAPES[name]))
    by_level = blocks_of_levels(levels, size)
    counts = [level.anchors for level in levels.levels]
    for number, blocks in enumerate(by_level):
        assert blocks.rows.sum(axis=1).max() <= size
        assert (blocks.rows.sum(axis=0) == np.diff([0, *counts[: number + 1]])).all()
        assert (np.diff(blocks.parent) >= 0).all()
        if number:
            above = by_level[number - 1]
            sums = np.zeros_like(above.rows)
            np.add.at(sums, blocks.parent, blocks.rows[:, :-1])
            assert (sums == above.rows).all()


def test_a_large_level_is_cut_in_even_pieces() -> None:
    levels = make_level_set(np.random.default_rng(0), Shape(anchors=(3000,), grids=(1,)))
    sizes = blocks_of_levels(sorted_levels(levels), 256)[0].rows[:, 0]
    assert sizes.max() <= 256
    assert sizes.min() >= 256 // 6


def test_the_bases_blocks_stand_in_the_order_of_the_first_view() -> None:
    plain = make_level_set(np.random.default_rng(0), Shape(anchors=(600, 1500), grids=(1, 1)))
    points = plain.shared.lattice[:600] * np.float64(plain.frame.voxel)
    eye = points.mean(axis=0) - [0, 0, 4 * np.ptp(points, axis=0).max()]
    w2c = np.column_stack([np.eye(3), -eye]).ravel().tolist()
    # A narrow view: of what is around the middle.
    levels = replace(plain, meta={"first": json.dumps({"w2c": w2c, "half": [0.05, 0.05]})})
    found = sorted_levels(levels, base=64)
    cuts = blocks_of_levels(found, base=64)
    sizes = cuts[0].rows[:, 0]
    assert len(sizes) > 8 and sizes.max() <= 64
    view = parse_first(levels.meta["first"])
    assert view is not None
    weights = view.weights(found.shared.lattice[:600] * np.float64(plain.frame.voxel))
    edges = np.concatenate([[0], np.cumsum(sizes)])
    worth = np.add.reduceat(weights, edges[:-1]) / sizes
    assert (np.diff(worth) <= 1e-12).all() and worth[0] > 10 * worth[-1]
    # The same rows, only elsewhere; what is in order stays; children follow their parents.
    rows = [sorted(map(tuple, each.shared.lattice.tolist())) for each in (plain, found)]
    assert rows[0] == rows[1]
    assert sorted_levels(found, base=64) is found
    assert (np.diff(cuts[1].parent) >= 0).all() and set(cuts[1].parent) == set(range(len(sizes)))
    data = encode_with_account(levels, "raw", base=64)[0]
    again = encode_with_account(decode(data, "levels"), "raw", base=64)[0]
    assert again == data


@pytest.mark.parametrize(
    "note",
    ["", "[]", "{}", '{"w2c": [1], "half": [1, 1]}', '{"w2c": [], "half": [0, 0]}', "{" * 5000],
)
def test_a_note_of_another_form_changes_nothing(note: str) -> None:
    levels = make_level_set(np.random.default_rng(0), Shape(anchors=(600,), grids=(1,)))
    assert parse_first(note) is None
    noted = sorted_levels(replace(levels, meta={"first": note}), base=64)
    assert (noted.shared.lattice == sorted_levels(levels).shared.lattice).all()


def index_of_a_city(anchors: tuple[int, ...], per_block: int) -> tuple[int, int]:
    """Bytes of the index, and of all directories, of a scene too large to train here."""
    rng = np.random.default_rng(0)
    header = Header._make([0] * len(Header._fields))._replace(
        levels=len(anchors), slots=10, features=4, residual=8
    )
    entry = LevelEntry._make([0] * len(LevelEntry._fields))._replace(
        head_hidden=32, codebook_rows=256, codebook_columns=32
    )
    levels = tuple(
        entry._replace(anchors=n, blocks=-(-n // per_block), grids=6 + 2 * k)
        for k, n in enumerate(anchors)
    )
    chunks = len(plan(header, levels))
    directories = 0
    for k, level in enumerate(levels):
        records = np.zeros(level.blocks, record_type(k))
        for name in ("stored", "raw", "crc", "live", "before", "low_x", "low_y", "low_z"):
            records[name] = rng.integers(0, 1 << 20, level.blocks)
        records["crc"] = rng.integers(0, 1 << 32, level.blocks)
        records["rows"] = rng.integers(0, per_block, (level.blocks, k + 1))
        directories += len(deflate(pack_directory(records))[0])
    return Index(header, levels, (None,) * chunks).length, directories  # type: ignore[arg-type]


def test_the_index_of_50_million_anchors_fits_16_kib() -> None:
    index, directories = index_of_a_city((7_000_000, 17_500_000, 35_000_000, 50_000_000), 12_000)
    assert index <= layout.INDEX_BYTES_MAX
    assert directories < 1 << 20
