import numpy as np
import pytest

from gsynopsis.pack import layout
from gsynopsis.pack.codecs import deflate
from gsynopsis.pack.directory import pack_directory, record_type
from gsynopsis.pack.index import Index, plan
from gsynopsis.pack.layout import Header, LevelEntry
from gsynopsis.pack.spatial import blocks_of_levels, sorted_levels
from tests.level_sets import SHAPES, Shape, make_level_set


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("size", [2, 8, 10_000])
def test_blocks_divide_their_parents_and_hold_at_most_so_many(name: str, size: int) -> None:
    levels = sorted_levels(make_level_set(np.random.default_rng(6), SHAPES[name]))
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
