"""A client that fetches what it likes: any order that parents allow, any subset of blocks."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.robust.forge import index_of, taken, with_record
from gsynopsis.container import Assembler, assembler, decode
from gsynopsis.container.blocks import column_bytes, shape_of
from gsynopsis.container.layout import Column, Kind
from gsynopsis.container.writer import encode_with_account
from gsynopsis.errors import ChecksumError, LayoutError, TruncatedError, ValueRangeError
from tests.level_sets import ALL_SHAPES, BOTH, Shape, assert_same, make_level_set

WIDE = Shape(anchors=(20, 50, 110, 200), slots=3, residual=2)
DATA = encode_with_account(make_level_set(np.random.default_rng(4), WIDE), block=16)[0]
SMALL = encode_with_account(make_level_set(np.random.default_rng(11), BOTH), block=8)[0]


def bare(data: bytes) -> Assembler:
    """A client with everything but blocks."""
    client = Assembler(data[:16384], "x")
    for chunk in client.index.chunks:
        if chunk.kind != Kind.BLOCKS:
            client.add(chunk, data[chunk.offset : chunk.offset + chunk.stored])
    return client


def give(client: Assembler, data: bytes, level: int, block: int) -> None:
    start, stop = client.directories[level].span_of(block)
    client.add_block(level, block, data[start:stop])


@pytest.mark.parametrize("coding", ["raw", "compact"])
@pytest.mark.parametrize("name", ALL_SHAPES)
def test_deltas_in_order_give_what_a_direct_load_gives(name: str, coding: str) -> None:
    levels = make_level_set(np.random.default_rng(3), ALL_SHAPES[name])
    data = encode_with_account(levels, coding, block=8)[0]
    whole, client = decode(data, "x"), Assembler(data[:16384], "x")
    for k, level in enumerate(client.index.levels):
        client.add_level(data[: level.end])
        assert client.levels_ready == k + 1
        assert_same(client.level_set(), whole.upto(k))
    with pytest.raises(LayoutError, match="after the last"):
        client.add_level(data)


@settings(max_examples=25)
@given(st.randoms(use_true_random=False))
def test_any_order_that_parents_allow_gives_the_same(random) -> None:  # type: ignore[no-untyped-def]
    client = bare(DATA)
    left = [(k, b) for k, d in client.directories.items() for b in range(len(d))]
    while left:
        ready = [
            (k, b)
            for k, b in left
            if not k or client.has_block(k - 1, int(client.directories[k].records["parent"][b]))
        ]
        chosen = random.choice(ready)
        give(client, DATA, *chosen)
        left.remove(chosen)
    assert client.levels_ready == 4
    assert_same(client.level_set(), decode(DATA, "x"))


def test_any_subset_of_the_next_level_can_be_drawn(rng: np.random.Generator) -> None:
    whole = decode(DATA, "x")
    for level in range(3):
        client = bare(DATA)
        for k in range(level + 1):
            for block in range(len(client.directories[k])):
                give(client, DATA, k, block)
        count = len(client.directories[level + 1])
        assert count > 1
        held = np.flatnonzero(rng.random(count) < 0.5)
        for block in held:
            give(client, DATA, level + 1, int(block))
        rows = [client.directories[level + 1].rows_of(int(block)) for block in held]
        fine = np.concatenate([np.zeros(0, np.int64), *rows])
        n = whole.levels[level].anchors
        kept = np.union1d(np.arange(n), fine)
        part = client.partial()
        assert (part.levels.shared.lattice == whole.shared.lattice[kept]).all()
        assert (part.region == np.where(np.isin(kept, fine), level + 1, level)).all()
        if not len(held):
            continue
        mask = np.zeros_like(whole.levels[level + 1].mask)
        mask[:n] = whole.levels[level].mask
        mask[fine] = whole.levels[level + 1].mask[fine]
        assert (part.levels.levels[-1].mask == mask[kept]).all()
        offsets = np.where(mask[:, :, None], whole.shared.offsets[: len(mask)], 0)
        assert (part.levels.shared.offsets == offsets[kept]).all()


def test_blocks_are_pieces_of_space_and_their_boxes_hold_them() -> None:
    client = bare(DATA)
    shared = decode(DATA, "x").shared
    for directory in client.directories.values():
        for number, record in enumerate(directory.records):
            points = shared.lattice[directory.rows_of(number)]
            assert points.min(axis=0).tolist() == [int(record[f"low_{a}"]) for a in "xyz"]
            assert points.max(axis=0).tolist() == [int(record[f"high_{a}"]) for a in "xyz"]
    sizes = [len(d) for d in client.directories.values()]
    assert sizes == sorted(sizes)
    assert sizes[-1] >= 200 // 16


def test_a_block_waits_for_its_directory_and_its_parent() -> None:
    client = Assembler(DATA, "x")
    with pytest.raises(LayoutError, match="level 0 block 0: found no record"):
        client.add_block(0, 0, b"")
    chunks = [c for c in client.index.chunks if c.kind == Kind.DIRECTORY]
    with pytest.raises(LayoutError, match="expected level 0 directory first"):
        client.add(chunks[1], DATA[chunks[1].offset : chunks[1].offset + chunks[1].stored])
    client = bare(DATA)
    with pytest.raises(LayoutError, match="expected level 0 block 0 first"):
        give(client, DATA, 1, 0)
    with pytest.raises(LayoutError, match="no record"):
        client.add_block(0, 99, b"")
    with pytest.raises(LayoutError, match="no complete level"):
        client.level_set()
    with pytest.raises(LayoutError, match="no complete level"):
        client.partial()


def test_after_a_bad_piece_the_good_one_is_taken() -> None:
    client = Assembler(DATA, "x")
    for chunk in client.index.chunks:
        body = DATA[chunk.offset : chunk.offset + chunk.stored]
        if chunk.kind == Kind.BLOCKS:
            with pytest.raises(LayoutError, match="add_block"):
                client.add(
                    chunk._replace(raw=chunk.stored, crc=__import__("zlib").crc32(body)), body
                )
            continue
        with pytest.raises(TruncatedError):
            client.add(chunk, body + b"\0")
        with pytest.raises(ChecksumError):
            client.add(chunk, bytes(len(body)))
        client.add(chunk, body)
    with pytest.raises(TruncatedError, match="level 0"):
        client.add_level(DATA[: client.index.levels[0].end - 1])
    for level, directory in client.directories.items():
        for block in range(len(directory)):
            start, stop = directory.span_of(block)
            with pytest.raises(TruncatedError):
                client.add_block(level, block, DATA[start : stop - 1])
            with pytest.raises(ChecksumError):
                client.add_block(level, block, bytes(stop - start))
            give(client, DATA, level, block)
    assert_same(client.level_set(), decode(DATA, "x"))


def test_what_a_client_gets_is_its_own() -> None:
    client = Assembler(SMALL, "x")
    for level in client.index.levels:
        buffer = bytearray(SMALL[: level.end])
        client.add_level(buffer)
        buffer[:] = bytes(len(buffer))
        got = client.level_set()
        got.levels[0].mask[:] = True
        got.shared.grids[0][:] = 7
        got.levels[0].codebook[:] = 7
        got.levels[0].networks["cov_b1"][:] = 7
        got.shared.lattice[:] = 7
    assert_same(client.level_set(), decode(SMALL, "x"))


def column_at(data: bytes, level: int, block: int, column: Column) -> slice:
    sizes = column_bytes(shape_of(index_of(data), level, taken(data).records[level][block]))
    start = sum(n for c, n in sizes.items() if c < column)
    return slice(start, start + sizes[column])


def with_column(data: bytes, level: int, block: int, column: Column, value: bytes) -> bytes:
    pieces = taken(data)
    raw = bytearray(pieces.raw_of(level, block))
    place = column_at(data, level, block, column)
    raw[place] = value * ((place.stop - place.start) // len(value))
    pieces.set_raw(level, block, bytes(raw))
    return pieces.data()


@pytest.mark.parametrize("column", [Column.LOG_SCALES, Column.RESIDUAL, Column.OFFSETS])
def test_parameters_that_are_not_finite_are_refused(column: Column) -> None:
    data = with_column(SMALL, 0, 0, column, b"\xff")
    with pytest.raises(ValueRangeError, match=r"level 0 block 0: found .*nan"):
        decode(data, "x")


@pytest.mark.parametrize("level", range(4))
def test_a_code_beyond_the_codebook_is_refused(level: int) -> None:
    data = with_column(SMALL, level, 0, Column.CODES, b"\x05")
    with pytest.raises(ValueRangeError, match=f"level {level} block 0: found 5, expected a code"):
        decode(data, "x")


def test_a_mask_of_another_count_is_refused() -> None:
    for value in (b"\0", b"\xff"):
        with pytest.raises(LayoutError, match=r"block 0: found (\d+ new live slots|padding)"):
            decode(with_column(SMALL, 0, 0, Column.MASK, value), "x")


def test_bits_beyond_the_mask_and_anchors_without_a_slot_are_refused() -> None:
    levels = make_level_set(np.random.default_rng(2), Shape(anchors=(3,), grids=(1,), slots=3))
    mask = np.array([[1, 1, 0], [0, 1, 0], [0, 1, 1]], np.bool_)
    data = encode_with_account(replace(levels, levels=(replace(levels.levels[0], mask=mask),)))[0]
    bits = np.append(mask.ravel(), np.zeros(7, np.bool_))
    bits[-1] = True
    padded = np.packbits(bits, bitorder="little").tobytes()
    with pytest.raises(LayoutError, match="padding bits"):
        decode(with_column(data, 0, 0, Column.MASK, padded), "x")
    moved = np.packbits([1, 1, 1, 0, 0, 0, 0, 1, 1], bitorder="little").tobytes()
    with pytest.raises(LayoutError, match="anchor 1 without a live slot"):
        decode(with_column(data, 0, 0, Column.MASK, moved), "x")


def test_a_coordinate_out_of_its_box_is_refused() -> None:
    record = taken(SMALL).records[0][0]
    for axis in "xyz":
        low, high = int(record[f"low_{axis}"]), int(record[f"high_{axis}"])
        for fields in ({f"low_{axis}": low + 1}, {f"high_{axis}": high - 1}):
            with pytest.raises(ValueRangeError, match=f"level 0 block 0: found {axis} from"):
                decode(with_record(SMALL, 0, 0, **fields), "x")


def test_whatever_records_still_refuse_is_a_layout_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object) -> None:
        raise ValueError("level 0: no")

    monkeypatch.setattr(assembler, "LevelSet", refuse)
    with pytest.raises(LayoutError, match="x: found level 0: no"):
        decode(SMALL, "x")
